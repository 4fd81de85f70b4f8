"""Generated data in the format of a released dataset: python src/export.py scenario=balls root=/where/CoPhy_224"""

from cophy.commands.export import run

if __name__ == "__main__":
    run()
