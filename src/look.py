"""Draw images of a dataset: python src/look.py scenario=balls"""

from cophy.commands.look import run

if __name__ == "__main__":
    run()
