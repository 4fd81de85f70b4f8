"""What a browser is served.

browser_clips: pictures of C and clips of AB that browsers play.
guards: headers, and limits on sizes and rates.
server: the addresses (HTTP).
serving: all of it put together, and served.
"""
