"""What other programs and sensors have recorded becomes a bag that `sal-height replay` processes.

Read `collection` first (a sensor, its track and its phase histories, and how they are written), then `description` (the
sensor in YAML), `arrays` (files of arrays), `track` and `recorded_track` (positions from CSV, SBET and bags),
`receiver` (a beam that follows a point, of which files state no antenna), `cphd` (compensated phase history data) and
`gotcha` (AFRL Gotcha).
"""

from sal_height.imports.arrays import import_arrays
from sal_height.imports.collection import Collection, level_states, write_collection
from sal_height.imports.cphd import import_cphd
from sal_height.imports.description import Description, read_description
from sal_height.imports.gotcha import import_gotcha
from sal_height.imports.recorded_track import read_recorded_track
from sal_height.imports.track import Track, read_track

__all__ = [
    "Collection",
    "Description",
    "Track",
    "import_arrays",
    "import_cphd",
    "import_gotcha",
    "level_states",
    "read_description",
    "read_recorded_track",
    "read_track",
    "write_collection",
]
