"""Import: recordings of other programs and sensors become a bag that `sal-height replay` processes.

Read `collection` first (a sensor in YAML, its track and its phase histories, and how they are written), then `arrays`
(files of arrays), `track` (positions from CSV, SBET and bags), `followed_point` (a dwell of a beam that follows a
point, of files that state no antenna), `gotcha` (AFRL Gotcha), `sarkit_files` (common parts of the next two), `cphd`
(compensated phase history data) and `crsd` (compensated radar signal data, and its channels as beams of an antenna);
and for focused images `sicd` (a file) and `slc` (those of all channels).
"""

from sal_height.imports.arrays import import_arrays
from sal_height.imports.collection import Collection, Description, level_states, read_description, write_collection
from sal_height.imports.cphd import import_cphd
from sal_height.imports.crsd import import_crsd
from sal_height.imports.gotcha import import_gotcha, read_gotcha
from sal_height.imports.slc import import_slc
from sal_height.imports.track import PlatformTrack, read_recorded_track, read_track

__all__ = [
    "Collection",
    "Description",
    "PlatformTrack",
    "import_arrays",
    "import_cphd",
    "import_crsd",
    "import_gotcha",
    "import_slc",
    "level_states",
    "read_description",
    "read_gotcha",
    "read_recorded_track",
    "read_track",
    "write_collection",
]
