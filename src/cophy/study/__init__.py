"""The human study of Table 1: participants see C, with or without AB, and click where each object will end.

plan: settings of a study, and who sees which experiment. experiments: their images and clips, and where objects are in
them. answers: the SQLite file. sessions: progress of the participants. server: the web server. judging: errors of the clicks
and the rows of Table 1. report: tables and figures. simulation: simulated participants, and the power of a study.
web/: the page (HTML, JavaScript, styles, text of the first page).
"""
