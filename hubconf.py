"""The entry of `torch.hub.load(FOLDER, "pretrained", source="local")`: the network that ships with siamloc."""

import analytic  # noqa: F401  (torch.hub finds the packages in this folder only while it reads this file)
from siamloc.models import pretrained  # noqa: F401

dependencies = ["cv2", "lazy_loader", "lightning", "numpy", "safetensors", "torch", "torchvision"]
