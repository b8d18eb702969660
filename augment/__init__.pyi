from .base import Effect as Effect
from .combinations import variants as variants
from .compose import Policy as Policy
from .contact_sheet import preview as preview
from .errors import AugmentError as AugmentError
from .policies import policy as policy, policy_from_config as policy_from_config
from .registry import EFFECTS as EFFECTS, POLICIES as POLICIES, effect as effect
from .transforms import Augment as Augment
