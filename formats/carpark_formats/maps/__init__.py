"""Maps of real car parks, read into layouts.

A format (`lanelet2`, `openstreetmap`, `geojson`, `dxf`) becomes `features`: polygons
and lines in metres. `assemble` makes a layout of them, and a report of omitted ones.

- *Frame*: most bays lie along x or y, and the middle of the map is the origin.
- *Spots*: a spot with four corners becomes the rectangle between its long sides: the
  longest in the outline where the spot leans, or up to 5 m long if its sides are. A
  spot of another shape becomes a rectangle of equal area. Overlaps with neighbours are
  cut off. A spot up to 0.1 m shorter than the compact car is lengthened into the aisle
  and reserved for parked cars.
- *Counted spots*: a row is divided into its number of spots, and a car park with aisles
  has bays of 5 m x 2.5 m on both sides of these. Diagonal rows lean as their outline
  does. Drawn spots stay. A point becomes a bay across the nearest road.
- *Stalls of drawings*: closed outlines, cells between lines, or the gap of 2 to 4 m
  between parallel lines of 4 to 8 m, at 30 to 90 degrees to the aisle. Lines of twice
  that length divide two rows back to back; lines of 1.8 to 3.5 m, 4.5 to 8 m apart,
  divide bays along a kerb.
- *Lanes*: lanelets, roads and aisles become straight lanes. Lanes in line are joined
  and extended to the next lane ahead, opposite lanes on one ground become a two-way
  lane, and short curved lanelets are dropped. A road without a width is 6 m wide, a
  one-way road 3.5 m. An aisle of a drawing is a polyline of constant width or a closed
  outline, one-way on layers such as `lane_one_way`.
- *Obstacles*: walls and kerbs become rectangles at most 0.5 m thicker, columns discs
  or, where bays leave them no room, rectangles; obstacles more than 1.5 m from drivable
  ground are left out. A closed barrier or a wall around spots is a line with gaps at
  roads. A roof is no wall.
- *Starts*: lanes and areas tagged `start`; without a lane with room for a car, the free
  ground between bays and walls; without ground, 6 m around the spots. Initial states
  of scenarios keep their heading.
"""
