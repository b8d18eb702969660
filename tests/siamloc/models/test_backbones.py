"""Networks of timm, torchvision and one's own as branches: their maps, normalization, weights and exported files."""

from __future__ import annotations

import sys
import types

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, FormatError
from siamloc.models import DistillationLoss, as_descriptor, build, load, save_weights, stages
from siamloc.models.branch import Branch
from siamloc.runtime import export_onnx

ensure_torchvision()
from torchvision import models  # noqa: E402

SIZE = (32, 128)
rng = torch.Generator().manual_seed
CONVOLUTIONAL = [
    "torchvision/mobilenet_v3_small",
    "torchvision/resnet18",
    "timm/test_resnet",
    "timm/resnet10t",
    "timm/test_convnext",
]
TRANSFORMERS = ["timm/test_vit", "timm/test_vit3"]
slow = pytest.mark.slow


@pytest.fixture(autouse=True)
def _no_timm_no_test(request):
    """Skip what needs timm where it is not installed."""
    names = getattr(getattr(request.node, "callspec", None), "params", {}).values()
    if any("timm/" in str(name) for name in names):
        ensure_torchvision()
        pytest.importorskip("timm")


def tiny_transformer(**options):
    """A transformer of torchvision with two layers."""
    torch.manual_seed(0)
    return models.VisionTransformer(32, 16, num_layers=2, num_heads=2, hidden_dim=24, mlp_dim=48, **options)


def described(network, seed=0, turn=0):
    images = torch.rand(2, 3, *network.image_size, generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        return network.eval()(images.roll(turn, dims=3))


def own():
    """A network of one's own."""
    return nn.Sequential(nn.Conv2d(3, 8, 4, stride=4), nn.ReLU(), nn.Conv2d(8, 16, 3, stride=2, padding=1))


class Pooled(nn.Module):
    """A network of one's own that only gives (B, 5)."""

    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(3, 5)

    def forward(self, images):
        return self.layer(images.mean(dim=(2, 3)))


@pytest.fixture
def factories(monkeypatch):
    """An imported module of one's own with factories."""
    module = types.ModuleType("siamloc_own_networks")
    module.own, module.nothing = own, lambda: 5
    monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.mark.parametrize("name", CONVOLUTIONAL)
def test_a_convolutional_network_describes_and_finds_headings(name):
    network = build(name, "magnitudes", SIZE, circular=True).eval()
    stride = SIZE[1] // network.grid[1]
    torch.testing.assert_close(described(network), described(network, turn=stride), rtol=1e-3, atol=1e-4)
    assert as_descriptor(network).tells_heading
    # A map of the network itself, at least twice as fine as its features; level 0 would be the pixels.
    assert network.orientation.level > 0
    images = torch.rand(2, 3, *SIZE)
    finer, features = network.branch.both(images, network.orientation.level)
    assert finer.shape[3] >= 2 * features.shape[3] == 2 * network.grid[1]
    torch.testing.assert_close(features, network.branch(images))
    assert stages(network)[0] == [f"branch.{key}" for key, _ in network.branch.named_parameters()]


@pytest.mark.parametrize(("name", "grid"), [("timm/pvt_v2_b0", (2, 4)), ("timm/xcit_nano_12_p8_224", (8, 16))])
def test_the_size_of_patches_that_overlap_is_not_asked_for(name, grid):
    assert build(name, "gem", (64, 128)).grid == grid


@pytest.mark.parametrize("name", TRANSFORMERS)
def test_the_tokens_of_a_transformer_are_a_map(name):
    network = build(name, "magnitudes", (64, 128))
    assert network.grid == (4, 8)
    # A change in one patch changes its own token most: rows and columns are where they belong.
    plain = torch.full((1, 3, 64, 128), 0.5)
    changed = plain.clone()
    changed[:, :, 16:32, 96:112] = 1.0
    network.eval()
    with torch.no_grad():
        apart = (network.branch(plain) - network.branch(changed)).abs().sum(dim=1)[0]
    assert divmod(int(apart.argmax()), 8) == (1, 6)


def test_a_transformer_of_torchvision_takes_panoramas():
    network = build(tiny_transformer(), "magnitudes", (32, 96))
    assert network.grid == (2, 6)
    again = build(tiny_transformer(), "magnitudes", (32, 96))
    torch.testing.assert_close(described(network), described(again))


@slow
def test_a_large_transformer_of_torchvision_by_its_name(tmp_path):
    network = build("torchvision/vit_b_16", "gem", (32, 64))
    assert network.grid == (2, 4)
    assert export_onnx(network, tmp_path / "vit.onnx", (32, 64))["max_abs_difference"] < 1e-4


@slow
@pytest.mark.parametrize(
    ("source", "circular"),
    [("timm/test_resnet", True), ("timm/test_vit", False), ("torchvision/mobilenet_v3_small", False)],
)
def test_the_exported_file_computes_the_same(source, circular, tmp_path):
    network = build(source, "magnitudes", (32, 64), circular=circular)
    report = export_onnx(network, tmp_path / "network.onnx", (32, 64))
    assert report["max_abs_difference"] <= report["tolerance"] * max(1, report["max_abs_value"])
    assert ("orientation" in report) == circular


@slow
def test_parts_of_features_that_hardly_vary_over_the_columns_are_exported(tmp_path):
    network, generator = build("torchvision/mobilenet_v3_small", "magnitudes", (64, 256), circular=True), rng(0)
    for layer in network.modules():  # as after a training: no scale is 1, and no shift 0
        if isinstance(layer, nn.BatchNorm2d):
            layer.weight.data.uniform_(0.5, 1.5, generator=generator)
            for shifted in (layer.bias.data, layer.running_mean):
                shifted.uniform_(-0.5, 0.5, generator=generator)
            layer.running_var.uniform_(0.05, 1.5, generator=generator)
    found = export_onnx(network, tmp_path / "network.onnx", (64, 256))["orientation"]
    assert found["max_abs_difference"] <= 1e-2 < found["max_abs_value"]


@slow
def test_a_transformer_that_is_handed_in_is_exported(tmp_path):
    report = export_onnx(build(tiny_transformer(), "gem", (32, 64)), tmp_path / "network.onnx", (32, 64))
    assert report["max_abs_difference"] < 1e-4


@pytest.mark.parametrize(
    ("name", "mean"), [("timm/test_vit", 0.5), ("timm/resnet10t", 0.485), ("torchvision/mobilenet_v3_small", 0.485)]
)
def test_images_are_normalized_as_the_model_card_says(name, mean):
    branch = build(name, "gem", SIZE).branch
    grey = torch.full((1, 3, *SIZE), mean)
    assert branch.normalized(grey)[:, 0].abs().max() < 1e-6
    assert build(name, "gem", SIZE, normalize="image").branch.normalized(grey).abs().max() < 1e-2


def test_googlenet_sees_images_as_torchvision_shows_them(tmp_path):
    torch.manual_seed(5)
    published = models.googlenet(transform_input=True, init_weights=False).eval()
    torch.save(published.state_dict(), tmp_path / "googlenet.pth")
    images, seen = torch.rand(1, 3, *SIZE), []
    published.avgpool.register_forward_pre_hook(lambda _, inputs: seen.extend(inputs))
    with torch.no_grad():
        published(Branch("simple1").normalized(images))  # with ImageNet's mean and deviation
        for source, weights in (("torchvision/googlenet", tmp_path / "googlenet.pth"), (published, None)):
            torch.testing.assert_close(build(source, "gem", SIZE, weights=weights).eval().branch(images), seen[0])


class Rescaling(models.GoogLeNet):
    """Rescales by itself, as its `forward` is kept whole."""

    def forward(self, images):
        return self.avgpool(self.conv1(self._transform_input(images)))


def test_a_network_of_ones_own_sees_images_by_the_deviation_of_imagenet():
    own = build(Rescaling(transform_input=True, init_weights=False), "gem", SIZE)
    assert own.branch.std.flatten().tolist() == pytest.approx([0.229, 0.224, 0.225])


def test_the_features_of_a_densenet_are_what_its_classes_are_made_of():
    torch.manual_seed(0)
    published = models.DenseNet(4, (1, 1), 8, bn_size=2).eval()
    images, features = torch.rand(1, 3, *SIZE), published.features
    with torch.no_grad():
        expected = features(Branch("simple1").normalized(images)).relu()
        torch.testing.assert_close(build(published, "gem", SIZE).eval().branch(images), expected)


@pytest.mark.parametrize("name", ["timm/test_resnet", "timm/test_vit", "torchvision/mobilenet_v3_small"])
def test_random_weights_follow_the_seed_alone(name):
    state = torch.random.get_rng_state()
    circular = "vit" not in name
    one, same, other = (described(build(name, "gem", SIZE, seed=seed, circular=circular)) for seed in (0, 0, 1))
    assert torch.equal(one, same)
    assert not torch.allclose(one, other)
    assert torch.equal(state, torch.random.get_rng_state())


@pytest.mark.parametrize(
    "name", ["timm/test_resnet", "timm/test_vit", "torchvision/mobilenet_v3_small", "torchvision/mnasnet0_5"]
)
def test_weights_come_from_a_file_of_the_source(name, tmp_path):
    source, _, own_name = name.partition("/")
    torch.manual_seed(5)
    if source == "timm":
        import timm

        published = timm.create_model(own_name)
    else:
        published = models.get_model(own_name, weights=None)
    save_file(published.state_dict(), tmp_path / "model.safetensors")
    torch.save(published.state_dict(), tmp_path / "model.pth")
    torch.save({"wrong": torch.ones(3)}, tmp_path / "wrong.pth")
    network = build(name, "gem", (160, 160), weights=tmp_path / "model.safetensors")
    first, filled = (
        next(part.weight for part in one.modules() if isinstance(part, nn.Conv2d)) for one in (published, network)
    )
    assert torch.equal(first, filled)
    again = build(name, "gem", (160, 160), weights=tmp_path / "model.pth")
    assert torch.equal(described(network), described(again))
    with pytest.raises(ConfigError, match=f"weights .*{own_name}|{own_name} cannot be made"):
        build(name, "gem", (160, 160), weights=tmp_path / "wrong.pth")


@pytest.mark.parametrize("name", ["timm/resnet10t", "torchvision/mobilenet_v3_small"])
def test_published_weights_are_never_fetched_unasked(name, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    if name.startswith("timm/"):
        hub = pytest.importorskip("huggingface_hub")
        monkeypatch.setattr(hub.constants, "HF_HUB_CACHE", str(tmp_path))
        monkeypatch.setattr(hub, "try_to_load_from_cache", lambda *where: None)
    with pytest.raises(ConfigError, match=r"fetch https://\S+ and (give|put)"):
        build(name, "gem", SIZE, weights="cached")
    with pytest.raises(ConfigError, match=r"loss\.weights=cached: .* fetch https://"):
        DistillationLoss(teacher=name)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConfigError, match="unknown weights 'best'"):
        build(name, "gem", SIZE, weights="best")


@pytest.mark.parametrize("name", ["timm/test_resnet"])
def test_published_weights_come_from_the_cache(name, tmp_path, monkeypatch):
    import timm

    hub = pytest.importorskip("huggingface_hub")
    torch.manual_seed(5)
    save_file(timm.create_model("test_resnet").state_dict(), tmp_path / "model.safetensors")
    monkeypatch.setattr(hub, "try_to_load_from_cache", lambda *where: str(tmp_path / "model.safetensors"))
    by_name, by_path = (build(name, "gem", SIZE, weights=one) for one in ("cached", tmp_path / "model.safetensors"))
    assert torch.equal(described(by_name), described(by_path))
    assert not torch.equal(described(by_name), described(build(name, "gem", SIZE)))


def test_timm_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(ConfigError, match=r"pip install '\.\[timm\]'"):
        build("timm/resnet18", "gem", SIZE)


@pytest.mark.parametrize(
    ("name", "size", "options", "says"),
    [
        ("timm/test_vit", SIZE, {"circular": True}, "cannot wrap around.*set model.circular=false"),
        ("timm/vit_small_patch16_dinov3", SIZE, {"circular": True}, "cannot wrap around"),
        ("timm/poolformer_s12", SIZE, {"circular": True}, "cannot wrap around"),
        ("timm/tf_efficientnet_lite0", SIZE, {"circular": True}, "cannot wrap around"),
        ("torchvision/swin_t", (64, 128), {"circular": True}, "cannot wrap around"),
        ("timm/test_vit", (30, 128), {}, r"patches of 16 x 16: take data.image_size=\[32,128\]"),
        ("timm/test_vit", SIZE, {"normalize": "local_and_colours"}, "has three channels"),
        ("timm/resnet1", SIZE, {}, "timm has no network 'resnet1': resnet"),
        ("torchvision/resnet1", SIZE, {}, "torchvision has no network 'resnet1'.*did you mean 'resnet"),
        ("keras/resnet", SIZE, {}, "give timm/NAME, torchvision/NAME, package.module:factory"),
        ("vgg17", SIZE, {}, "did you mean 'vgg1.'.*timm/NAME"),
        ("not_imported:factory", SIZE, {}, "arguments; the module not_imported is not imported: import it first"),
        # A file calls no function of Python itself.
        *((name, SIZE, {}, "has no function or torch module") for name in ("sys:exit", "os:getpid", "builtins:input")),
        ("siamloc_own_networks:missing", SIZE, {}, "no arguments; the module .* torch module 'missing'"),
        ("siamloc_own_networks:nothing", SIZE, {}, "must give a torch module, got int"),
    ],
)
@pytest.mark.usefixtures("factories")
def test_what_cannot_be_built_is_said_in_one_sentence(name, size, options, says):
    with pytest.raises(ConfigError, match=says):
        build(name, "gem", size, **options)


def test_a_transformer_of_odd_size_is_refused_in_torchvision_too():
    with pytest.raises(ConfigError, match=r"patches of 16 x 16: take data.image_size=\[32,96\]"):
        build(tiny_transformer(), "gem", (33, 96))


def test_a_module_that_is_handed_in_is_loaded_into_another():
    network = build(own(), "gem", SIZE)
    assert "branch" not in network.settings
    assert described(network).shape == (2, 256)
    assert build(Pooled(), "gem", SIZE).grid == (1, 1)
    with pytest.raises(ConfigError, match=r"must give \(B, C, h, w\) or \(B, D\).*got \(1, 3, 4096\)"):
        build(nn.Flatten(2), "gem", SIZE)
    with pytest.raises(ConfigError, match=r"Linear fails with images of 32 x 128 pixels, in its own words: .*mat1"):
        build(nn.Linear(5, 5), "gem", SIZE)


def test_positions_that_are_still_zero_are_positions():
    class Placed(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer, self.positions = nn.Conv2d(3, 8, 8, 8), nn.Parameter(torch.zeros(1, 4 * 16, 8))

        def forward(self, images):
            found = self.layer(images)
            return (found.flatten(2).mT + self.positions).mT.reshape(found.shape)

    assert build(Placed(), "gem", SIZE).grid == (4, 16)
    with pytest.raises(ConfigError, match=r"the columns cannot wrap around in .*Placed"):
        build(Placed(), "gem", SIZE, circular=True)


def test_a_module_that_is_handed_in_is_saved_with_the_arguments_of_its_network(tmp_path):
    network = build(own(), "gem", SIZE, circular=True, normalize="image")
    assert {
        "class": "Sequential",
        "head": "gem",
        "circular": True,
        "normalize": "image",
    }.items() <= network.settings.items()
    path = save_weights(network, tmp_path / "saved.safetensors")
    again = load(path, network=build(own(), "gem", SIZE, circular=True, normalize="image", seed=1))
    torch.testing.assert_close(described(network), described(again), rtol=1e-2, atol=1e-2)
    with pytest.raises(FormatError, match="was built with circular=True, and the given one with circular=False: build"):
        load(path, network=build(own(), "gem", SIZE, normalize="image"))
    wider = load(path, network=build(own(), "gem", (32, 256), circular=True, normalize="image"))
    assert wider.image_size == (32, 256)
    with pytest.raises(ConfigError, match=r"a module of your own, Sequential \+ gem at 32 x 128, which no command"):
        load(path)


@pytest.mark.parametrize("name", ["timm/test_resnet", "torchvision/mobilenet_v3_small", "siamloc_own_networks:own"])
@pytest.mark.usefixtures("factories")
def test_a_saved_network_is_loaded_again(name, tmp_path):
    network = build(name, "magnitudes", SIZE, circular=True, seed=3)
    again = load(save_weights(network, tmp_path / "saved.safetensors"))
    assert again.settings["branch"] == name
    torch.testing.assert_close(described(network), described(again), rtol=1e-2, atol=1e-2)  # half precision
    further = build(name, "gem", SIZE, circular=True, weights=tmp_path / "saved.safetensors")
    images = torch.rand(1, 3, *SIZE)
    torch.testing.assert_close(further.eval().branch(images), again.branch(images))
