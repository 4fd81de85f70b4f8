"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

from cophy.commands.generate import main

if __name__ == "__main__":
    main()
