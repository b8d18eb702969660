from .decision import Change as Change, Decision as Decision, Location as Location, Reason as Reason, replay as replay
from .graph import NodeGraph as NodeGraph
from .mapper import IncrementalMapper as IncrementalMapper
from .parameters import Parameters as Parameters
