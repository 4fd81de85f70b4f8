"""The human study of Table 1: people see C, with or without AB, and click where every object will end.

study_settings: what a study is, and its name.
plan: which experiments a participant sees, in which setting and order.
answers: what a person says of one experiment, checked.
answer_store: one SQLite file with participants, answers and clicks.
answer_tables: its tables, and whether a file is such a one.
sessions: where a participant is, and what may come next.
experiments: the experiments of a study, and who sees which.
scenes: what C shows of every object, and where objects end in the picture.
results/: what came of a study: clicks, how far off they are, the rows of Table 1.
pages/: what a browser is served.
simulation/: simulated participants, and the power of a study.
web/: the page itself (HTML, JavaScript, styles, the text of the first page).
"""
