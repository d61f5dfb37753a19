"""Drop tests by camera, sound or contact: restitution, friction and drag of a ball bouncing on a plate at rest.

`load` reads any file into impact times or a path; `times` and `film` fit nested models to them (`laws`), `outcome` and
`filmed` turn the fits into results, `figures` draws them. What the data cannot carry is null, and said in words.
"""
