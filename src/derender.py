"""Positions and presence in every frame, as a de-renderer sees them: python src/derender.py scenario=balls size=small"""

from cophy.commands.derender import main

if __name__ == "__main__":
    main()
