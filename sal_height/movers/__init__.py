"""What moves in the images of a strip: read `detection`, then `likelihood`, `spectrum` and `walk`."""

from sal_height.movers.detection import check_sensor, find_movers
from sal_height.movers.mover import Looked, Mover
from sal_height.movers.settings import MoverSettings

__all__ = ["Looked", "Mover", "MoverSettings", "check_sensor", "find_movers"]
