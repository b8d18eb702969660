from . import draw as draw, page as page
from .page.write import write_report as write_report
