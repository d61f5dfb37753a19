"""Drop tests by camera, sound or contact: restitution, friction and drag of a ball bouncing on a plate at rest.

`load` reads any file into impact times, a path or a fall; `times`, `film` and `falls` fit nested models to them
(`laws`), the `outcome` of each turns the fit into a result, `figures` draws it. What the data cannot carry is null, and
said in words.
"""
