from .augment import Expand as Expand, Preview as Preview
from .doctor import Doctor as Doctor
from .evaluate import Evaluate as Evaluate
from .export import Export as Export
from .fetch import Fetch as Fetch
from .job import Job as Job
from .map import MapFrames as MapFrames
from .prepare import Prepare as Prepare
from .report import Compare as Compare, Report as Report
from .reproduce import Reproduce as Reproduce
from .robot import Localize as Localize, Watch as Watch
from .simulate import Simulate as Simulate
from .survey import SurveyDrives as SurveyDrives
from .train import Pretrain as Pretrain, Train as Train
from .walk import Walk as Walk
