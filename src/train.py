"""Train and test one model on one split: python src/train.py scenario=balls model=cophynet"""

from cophy.commands.train import main

if __name__ == "__main__":
    main()
