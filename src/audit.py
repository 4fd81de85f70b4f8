"""Prove the datasets of a split sound: python src/audit.py scenario=balls size=small (exit code 1 when they are not)"""

from cophy.commands.audit import run

if __name__ == "__main__":
    run()
