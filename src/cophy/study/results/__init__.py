"""What came of a study.

answer_file: reads a file of answers.
judging: how far clicks are from the truth, and the rows of Table 1.
"""
