"""Audit the datasets of a split: python src/audit.py scenario=balls size=small (exit code 1 if a check fails)"""

from cophy.commands.audit import main

if __name__ == "__main__":
    main()
