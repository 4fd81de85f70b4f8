"""Export generated data in the format of CoPhy_224: python src/export.py scenario=balls root=/where/CoPhy_224"""

from cophy.commands.export import main

if __name__ == "__main__":
    main()
