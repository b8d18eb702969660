from .calibration import read_calibration as read_calibration
from .cameras import (
    DoubleSphereCamera as DoubleSphereCamera,
    DualFisheyeCamera as DualFisheyeCamera,
    EquirectangularCamera as EquirectangularCamera,
    FisheyeCamera as FisheyeCamera,
    HyperbolicMirror as HyperbolicMirror,
    OCamCamera as OCamCamera,
    UnifiedCamera as UnifiedCamera,
)
from .central import CentralCamera as CentralCamera, LensCamera as LensCamera
from .checks import check as check, room_sizes as room_sizes, summary as summary
from .decoding import Preprocessing as Preprocessing
from .examples import example as example
from .expansion import Expanded as Expanded, expand as expand
from .extracting import Contents as Contents, Extraction as Extraction, contents as contents, extract as extract
from .fetching import Fetched as Fetched, fetch as fetch
from .frames import FrameTable as FrameTable, concatenate as concatenate
from .library import PanoramaLibrary as PanoramaLibrary
from .mounting import Mounting as Mounting, MountingEstimate as MountingEstimate, find_mounting as find_mounting
from .occupancy import OccupancyMap as OccupancyMap, read_occupancy as read_occupancy
from .panorama import (
    OmnidirectionalCamera as OmnidirectionalCamera,
    PanoramaView as PanoramaView,
    PolarRing as PolarRing,
    azimuth_column as azimuth_column,
    column_azimuth as column_azimuth,
    seen as seen,
    unwrap as unwrap,
)
from .protocol import Protocol as Protocol, Role as Role
from .reading import DataSettings as DataSettings, READERS as READERS, read as read
from .presets import AutoRing as AutoRing, ColdRing as ColdRing
from .ring import (
    RingFit as RingFit,
    find_camera as find_camera,
    find_centres as find_centres,
    find_ring as find_ring,
)
from .trajectory import Trajectory as Trajectory, read_trajectory as read_trajectory
