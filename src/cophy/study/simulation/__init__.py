"""Simulated participants, who take the study over HTTP before people do. They are never counted as people.

strategies: how they answer.
visits: how they go through the pages.
power: how many people tell the two settings apart, if people are like a simulated kind.
"""
