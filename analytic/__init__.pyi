from . import clustering as clustering, measures as measures
from .description import Alignment as Alignment, Description as Description, Match as Match
from .descriptors.base import Descriptor as Descriptor, ImageDescriptor as ImageDescriptor
from .descriptors.fused import Fused as Fused
from .descriptors.registry import DESCRIPTORS as DESCRIPTORS, descriptor as descriptor
from .distances import DISTANCES as DISTANCES, distance as distance
from .errors import AnalyticError as AnalyticError
from .mapper import Decision as Decision, IncrementalMapper as IncrementalMapper, Reason as Reason
