"""Train and test one model on one split: python src/train.py scenario=balls model=cophynet"""

from cophy.commands.train import run

if __name__ == "__main__":
    run()
