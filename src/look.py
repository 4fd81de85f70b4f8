"""Draw images of a dataset: python src/look.py scenario=balls"""

from cophy.commands.look import main

if __name__ == "__main__":
    main()
