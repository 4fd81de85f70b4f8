"""What stands beside pictures.

text: lines of text as pictures.
color_bar: a scale of colours.
words: an experiment in words.
"""
