"""List the commands: python -m cophy"""

import ast
import sys
from pathlib import Path

for path in sorted(Path(__file__).with_name("commands").glob("[a-z]*.py")):
    description, _, _ = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition(": python ")
    sys.stdout.write(f"cophy-{path.stem:<10} {description}\n")
sys.stdout.write("\nEach has --help. In a checkout, python src/train.py is the same as cophy-train.\n")
sys.exit(2 if sys.argv[1:] else 0)  # nothing is run here
