"""Tables and figures from outputs/, ours beside the paper's numbers: python src/report.py"""

from cophy.commands.report import main

if __name__ == "__main__":
    main()
