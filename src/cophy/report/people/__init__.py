"""What people clicked in the human study, and what simulated participants did; the two are never counted together.

study_answers: the files of answers, judged with the data that they are on.
study_tables: the rows of Table 1, and tables of every study.
study_figures: dots of people and circles of truth on the pictures of C (the paper's two figures).
"""
