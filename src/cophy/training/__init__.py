"""Lightning modules, losses and metrics."""
