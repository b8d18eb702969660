from .learning import pretrain as pretrain
from .settings import RECIPE as RECIPE, ViewSettings as ViewSettings
from .view_batches import ViewDataModule as ViewDataModule
