"""Predict a counterfactual from images: python src/predict.py observed=AB/ initial=C.png derenderer=… predictor=…"""

from cophy.commands.predict import run

if __name__ == "__main__":
    run()
