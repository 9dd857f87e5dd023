"""Maps of real car parks, read into layouts; needs the extra `maps`.

A format (`lanelet2`, `openstreetmap`, `geojson`, `dxf`) becomes `features`: polygons
and lines in metres. `assemble` makes a layout of them, and a report of omitted ones.
"""
