"""The lab page, which shows variants of a scene side by side in a browser, and the command line."""
