"""Drop tests by camera, sound or contact: restitution, friction and drag of a ball bouncing on a plate at rest.

The rule kept here: whatever the instrument, a drop becomes impact times (and, for a camera, flights between them), and
the same ladder of models is judged on bounces it did not fit; where the data cannot carry a number, the result says so.
"""
