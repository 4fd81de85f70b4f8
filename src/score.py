"""Score predictions of any model: python src/score.py scenario=collision predictions=mine.npz"""

from cophy.commands.score import main

if __name__ == "__main__":
    main()
