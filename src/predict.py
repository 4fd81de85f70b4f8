"""Predict a counterfactual from images: python src/predict.py observed=AB/ initial=C.png derenderer=… predictor=…"""

from cophy.commands.predict import main

if __name__ == "__main__":
    main()
