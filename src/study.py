"""The human study of Table 1: python src/study.py scenario=blocktower"""

from cophy.commands.study import main

if __name__ == "__main__":
    main()
