"""Contact edges and accelerometer impacts, each with a time and its uncertainty.

Other rooms take `levels`, `edges`, `ac_coupling`, `short_contacts`, `edge_jitter`, `impact_template`,
`template_estimate`, `impact_detection` and `sensor_offset`.
"""
