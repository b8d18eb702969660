from .bundle import Bundle as Bundle
from .exporting import export as export
from .live import Live as Live
from .localizer import Localizer as Localizer
from .location import Candidate as Candidate, Location as Location
from .onnx_model import export_onnx as export_onnx, parity as parity
from .precision import precision_table as precision_table
from .stream import Located as Located, locate_all as locate_all, written as written
from .updating import update as update
