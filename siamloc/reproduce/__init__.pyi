from .claims import examine as examine
from .page import write_report as write_report
from .reproduction import Reproduction as Reproduction
from .running import reproduce as reproduce
from .study_book import Study as Study, listing as listing, studies as studies, study as study
