"""The desk's web server: application, access, page frame and style, to which sections of pages are added.

A section (`bench.web.serve.Section`) is a module's part of the desk. Nothing here knows a section, and no page needs
anything from outside the machine.
"""
