from __future__ import annotations

import json
import re

import cv2
import numpy as np
import pytest

from siamloc.data import DualFisheyeCamera, FisheyeCamera, read_calibration
from siamloc.data.decoding import Preprocessing
from siamloc.errors import ConfigError, DataError
from tests.oracles import cameras as oracle

KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0007, -0.0020, 0.0002]
  distortion_model: equidistant
  intrinsics: [190.97, 190.97, 254.93, 256.89]
  resolution: [512, 510]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [-0.99986, 0.0, 0.01674, 0.012]
  - [0.0, 1.0, 0.0, 0.0]
  - [-0.01674, 0.0, -0.99986, 0.001]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: omni
  distortion_coeffs: [-0.12, 0.03, 0.0002, -0.0001]
  distortion_model: radtan
  intrinsics: [1.21, 420.5, 421.5, 255.1, 256.2]
  resolution: [512, 510]
  rostopic: /cam1/image_raw
cam2:
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.18, 0.59, 156.9, 156.8, 254.9, 255.8]
  resolution: [512, 510]
cam3:
  camera_model: eucm
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [0.6, 1.1, 156.9, 156.8, 254.9, 255.8]
  resolution: [512, 510]
"""
OCAM = """\
#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). These are used by cam2world

5 -6.9696915e+02 0.0 5.3e-04 -1.6e-07 2.1e-10

#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). These are used by world2cam

9 1150.1 653.8 -23.9 93.1 66.2 -25.4 15.8 21.7 4.9

#center: "row" and "column", starting from 0 (C convention)

968.4 1293.9

#affine parameters "c", "d", "e"

1.0003 -0.0004 0.0007

#image size: "height" and "width"

1944 2592
"""
ROS = """\
image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [200.5, 0, 320.1, 0, 201.5, 240.2, 0, 0, 1]
distortion_model: equidistant
distortion_coefficients:
  rows: 1
  cols: 4
  data: [0.01, 0.002, -0.001, 0.0003]
"""
MEI = """\
%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 752
image_height: 480
mirror_parameters:
   xi: 1.87
distortion_parameters:
   k1: -0.11
   k2: 0.42
   p1: 0.0008
   p2: -0.0003
projection_parameters:
   gamma1: 1120.4
   gamma2: 1118.1
   u0: 362.4
   v0: 245.5
"""
KANNALA_BRANDT = """\
%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: camera
image_width: 752
image_height: 480
projection_parameters:
   k2: 0.0034
   k3: 0.0007
   k4: -0.0020
   k5: 0.0002
   mu: 461.3
   mv: 460.2
   u0: 362.4
   v0: 245.5
"""
EUROC = """\
# General sensor definitions.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
rate_hz: 20
resolution: [512, 510]
camera_model: pinhole
intrinsics: [190.97, 190.97, 254.93, 256.89] #fu, fv, cu, cv
distortion_model: equidistant
distortion_coefficients: [0.0034, 0.0007, -0.0020, 0.0002]
"""
MATRIX = np.array([[200.5, 0.3, 320.1], [0, 201.5, 240.2], [0, 0, 1]])
BENT = np.array([0.01, 0.002, -0.001, 0.0003])
RAYS = np.array([(1, 0.01, 0), (1, 0.3, -0.2), (1, -0.8, 0.4), (0.3, 0.5, 0.4)])


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def stored(path, **values):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return path


def agrees(camera, project):
    expected = [project(*oracle.turned(ray, camera), camera) for ray in RAYS]
    np.testing.assert_allclose(camera.project(RAYS), expected, atol=0.01)


@pytest.mark.parametrize(
    ("name", "project"), [("cam0", oracle.fisheye), ("cam1", oracle.unified), ("cam2", oracle.double_sphere)]
)
def test_a_chain_of_kalibr(tmp_path, name, project):
    camera = read_calibration(written(tmp_path / "chain.yaml", KALIBR), name, azimuth=5)
    assert (camera.image_size, camera.azimuth) == ((510, 512), 5)
    agrees(camera, project)
    numbers = [float(word) for word in KALIBR.split(f"{name}:")[1].split("intrinsics: [")[1].split("]")[0].split(",")]
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == numbers[-4:]


def test_the_sensor_file_of_a_drive_of_euroc_is_read_like_a_chain_of_kalibr(tmp_path):
    camera = read_calibration(written(tmp_path / "chain.yaml", KALIBR), "cam0")
    assert read_calibration(written(tmp_path / "sensor.yaml", EUROC)) == camera


def test_two_cameras_of_a_chain_are_two_lenses(tmp_path):
    camera = read_calibration(written(tmp_path / "chain.yaml", KALIBR), ["cam0", "cam1"], azimuth=90)
    assert isinstance(camera, DualFisheyeCamera)
    turn = np.array([[-0.99986, 0, 0.01674], [0, 1, 0], [-0.01674, 0, -0.99986]])
    behind = np.array([(-0.9, 0.1, 0.2), (-1, -0.4, -0.3)])
    for ray in behind:
        in_first = np.array([-ray[1], -ray[2], ray[0]])
        expected = np.array(oracle.unified(*(turn @ in_first), camera.back)) + np.array([512, 0])
        about_up = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        np.testing.assert_allclose(camera.project(about_up @ ray, (510, 1024)), expected, atol=0.01)
    assert camera.project(np.array([0, 1, 0]), (510, 1024)) == pytest.approx([254.93, 256.89])


@pytest.mark.parametrize("suffix", ["yaml", "xml", "json"])
def test_files_of_opencv(tmp_path, suffix):
    about = {"image_width": 640, "image_height": 480, "camera_matrix": MATRIX, "distortion_coefficients": BENT}
    fisheye = read_calibration(stored(tmp_path / f"a.{suffix}", **about, fisheye_model=1), elevation=90)
    assert fisheye == FisheyeCamera(
        fx=200.5, fy=201.5, cx=320.1, cy=240.2, skew=0.3, k=BENT, elevation=90, image_size=(480, 640)
    )
    points, _ = cv2.fisheye.distortPoints(np.zeros((1, 1, 2)), MATRIX, BENT.reshape(1, 4), alpha=0.3 / 200.5), None
    np.testing.assert_allclose(fisheye.project(np.array([0, 0, 1])), points[0, 0], atol=1e-6)
    omnidir = read_calibration(stored(tmp_path / f"b.{suffix}", K=MATRIX, D=BENT, xi=np.array([[1.3]])))
    assert (omnidir.xi, omnidir.distortion, omnidir.image_size) == (1.3, tuple(BENT), None)
    assert read_calibration(stored(tmp_path / f"c.{suffix}", K=MATRIX, D=BENT, xi=1.3)) == omnidir


def test_camera_info_of_ros(tmp_path):
    camera = read_calibration(written(tmp_path / "info.yaml", ROS))
    assert (camera.image_size, camera.k) == ((480, 640), tuple(BENT))
    agrees(camera, oracle.fisheye)


def test_the_camera_info_of_a_recording(tmp_path):
    own = {"width": 640, "height": 480, "distortion_model": "equidistant"}
    own |= {"d": BENT.tolist(), "k": MATRIX.ravel().tolist()}
    topics = {"/front/camera_info": {**own, "distortion_model": "plumb_bob"}, "/omni/camera_info": own}
    file = written(tmp_path / "camera_info.json", json.dumps(topics))
    camera = read_calibration(file, "/omni/camera_info")
    assert (camera.image_size, camera.k, camera.skew) == ((480, 640), tuple(BENT), 0.3)
    for topic in ("/omni/image_raw", "/omni/image_raw/compressed"):
        assert read_calibration(file, topic) == camera
    with pytest.raises(DataError, match=r"/front/camera_info of .* has the distortion model plumb_bob"):
        read_calibration(file, "/front/image_raw")
    with pytest.raises(ConfigError, match="several cameras: give camera=NAME, one of /front/camera_info, /omni/camera"):
        read_calibration(file)
    one = written(tmp_path / "one.json", json.dumps({"/omni/camera_info": own}))
    assert read_calibration(one) == camera
    with pytest.raises(ConfigError, match="has no camera '/front/image_raw'"):
        read_calibration(one, "/front/image_raw")


def test_a_topic_gives_the_camera_that_has_it_or_is_alone_next_to_it(tmp_path):
    own = {"width": 640, "height": 480, "distortion_model": "equidistant", "d": BENT.tolist()}
    cameras = {side: {**own, "k": [fx, 0, 320, 0, fx, 240, 0, 0, 1]} for side, fx in (("left", 200), ("right", 300))}
    file = written(tmp_path / "a.json", json.dumps({f"/cams/{side}_info": one for side, one in cameras.items()}))
    assert read_calibration(file, "/cams/right_info").fx == 300
    several = r"of several cameras, and /cams/right_image may be of any: give camera=NAME, one of /cams/left_info, "
    with pytest.raises(ConfigError, match=several):
        read_calibration(file, "/cams/right_image")
    with pytest.raises(ConfigError, match="of several cameras: give camera=NAME"):
        read_calibration(file, [])
    cameras["left"]["rostopic"], cameras["right"]["rostopic"] = "/cams/a", "/cams/b/compressed"
    file = written(tmp_path / "b.json", json.dumps({f"/cams/{side}_info": one for side, one in cameras.items()}))
    for topic in ("/cams/b", "/cams/b/compressed"):
        assert read_calibration(file, topic).fx == 300


def test_a_file_of_ocamcalib(tmp_path):
    camera = read_calibration(written(tmp_path / "calib_results.txt", OCAM))
    assert (camera.image_size, camera.cx, camera.cy) == ((1944, 2592), 1293.9, 968.4)
    agrees(camera, oracle.ocam)


@pytest.mark.parametrize("text", [MEI, KANNALA_BRANDT])
def test_files_of_camodocal(tmp_path, text):
    """Points as the models of CamOdoCal are defined, from the numbers of the file alone."""
    own = {name: float(value) for name, value in re.findall(r"^   (\w+): (\S+)$", text, re.MULTILINE)}
    for head in ("", text[: text.index("model")]):  # the plain YAML that people write by hand, and OpenCV's
        camera = read_calibration(written(tmp_path / "camera.yaml", head + text[text.index("model") :]), azimuth=90)
        assert (camera.image_size, camera.azimuth) == ((480, 752), 90)
        for x, y, z in [(0.1, 0.2, 1.0), (-0.7, 0.3, 0.8), (0.5, -0.9, 0.4)]:
            norm, side = np.sqrt(x**2 + y**2 + z**2), np.hypot(x, y)
            if text is MEI:
                x_n, y_n = x / (z + own["xi"] * norm), y / (z + own["xi"] * norm)
                r2 = x_n**2 + y_n**2
                radial = 1 + own["k1"] * r2 + own["k2"] * r2**2
                u = x_n * radial + 2 * own["p1"] * x_n * y_n + own["p2"] * (r2 + 2 * x_n**2)
                v = y_n * radial + own["p1"] * (r2 + 2 * y_n**2) + 2 * own["p2"] * x_n * y_n
                expected = [own["gamma1"] * u + own["u0"], own["gamma2"] * v + own["v0"]]
            else:
                t = np.arctan2(side, z)
                r = t + own["k2"] * t**3 + own["k3"] * t**5 + own["k4"] * t**7 + own["k5"] * t**9
                expected = [own["mu"] * r * x / side + own["u0"], own["mv"] * r * y / side + own["v0"]]
            # the camera looks to the left: its right is the robot's front
            np.testing.assert_allclose(camera.project(np.array([x, z, -y])), expected, atol=0.01)


def test_files_with_a_mark_of_their_byte_order(tmp_path):
    for text in (OCAM, ROS):
        plain = read_calibration(written(tmp_path / "plain", text))
        assert read_calibration(written(tmp_path / "marked", f"\ufeff{text}")) == plain


def test_the_command_line_names_the_file_and_a_run_keeps_the_camera(tmp_path):
    file = written(tmp_path / "chain.yaml", KALIBR)
    made = Preprocessing.checked(
        (64, 256), {"kind": "calibrated", "file": str(file), "camera": "cam1", "elevation": 90, "fov": None}
    )
    kept = made.unwrap_settings()
    assert (kept["kind"], kept["xi"], kept["elevation"], kept["image_size"]) == ("unified", 1.21, 90, [510, 512])
    assert Preprocessing.checked((64, 256), kept) == made == Preprocessing.of(made.parameters())


@pytest.mark.parametrize(
    ("text", "camera", "error", "message"),
    [
        (KALIBR, "cam9", ConfigError, "has no camera 'cam9': .*valid: cam0, cam1"),
        (KALIBR, None, ConfigError, "is of several cameras: give camera=NAME, one of cam0, cam1"),
        (ROS.replace("distortion_model: equidistant", ""), None, DataError, "add the key fisheye_model with the value"),
        (KALIBR, "cam3", DataError, "cam3 of .* is of the model eucm with none distortion: Kalibr's omni"),
        (
            EUROC.replace("equidistant", "radial-tangential"),
            None,
            DataError,
            "with radial-tangential .*data.circular=false",
        ),
        (KALIBR, ["cam0", "cam1", "cam2"], ConfigError, "one camera or two"),
        (KALIBR, ["cam1", "cam2"], DataError, "cam2 of .* has no T_cn_cnm1"),
        (KALIBR.replace("190.97, 190.97, ", ""), "cam0", DataError, "has 2 intrinsics and 4 .*pinhole has 4 and 4"),
        (KALIBR.replace("resolution: [512, 510]", "a: 1", 1), "cam0", DataError, "resolution of cam0 must be"),
        (KALIBR.replace("190.97", "nan", 1), "cam0", DataError, "intrinsics of cam0 must be finite numbers"),
        (ROS.replace("equidistant", "plumb_bob"), None, DataError, "model plumb_bob and 4 .*data.circular=false"),
        (ROS.replace("equidistant", "rational_polynomial"), "cam0", ConfigError, "is of one camera: leave out"),
        (
            ROS.replace("camera_matrix", "matrix"),
            None,
            DataError,
            "no camera matrix among image_width.*by hand, as unwrap=",
        ),
        ('%YAML:1.0\n---\ncam0_calib: "mei.yaml"\n', None, DataError, "is no calibration, .*: give .*/mei.yaml$"),
        (ROS.replace("200.5, ", ""), None, DataError, "the camera matrix must be 9 finite numbers"),
        (OCAM.partition("#affine")[0], None, DataError, "is not whole: OCamCalib writes five lines"),
        (OCAM.replace("5 -6", "6 -6"), None, DataError, "announces 6 coefficients and lists 5"),
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3", None, DataError, "not whole|camera matrix must be"),
        ("%YAML:1.0\n---\nmodel_type: MEI\nmirror:\n   xi: 1.9", None, DataError, "gamma1, .* of MEI must be finite"),
        (MEI.replace("MEI", "PINHOLE"), None, DataError, "is of the model PINHOLE: .*data.circular=false"),
        (MEI.replace("   u0: 362.4\n", ""), None, DataError, "gamma1, gamma2, u0, .* of MEI must be finite numbers"),
        ("model_type: MEI\nmirror_parameters: [1.9]", None, DataError, "gamma1, .* of MEI must be finite numbers"),
        (KANNALA_BRANDT.replace("image_width: 752\n", ""), None, DataError, "the image size must be finite numbers"),
        ("a: [1", None, DataError, "is not YAML"),
        ("just words", None, DataError, "is not a calibration file"),
        ("", None, DataError, "is not a calibration file"),
        (KALIBR.replace("-0.12, 0.03", "1e20, 0.03"), "cam1", ConfigError, "unwrap.distortion must be a list of 4"),
    ],
)
def test_calibrations_that_cannot_be_used(tmp_path, text, camera, error, message):
    with pytest.raises(error, match=message):
        read_calibration(written(tmp_path / "calibration.yaml", text), camera)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(DataError, match="cannot be read: No such file"):
        read_calibration(tmp_path / "none.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="cannot be read"):
        read_calibration(tmp_path / "bytes.yaml")
    (tmp_path / "long.yaml").write_text("#" * 1_000_001)
    with pytest.raises(DataError, match="it has 1,000,001 bytes, more than 1,000,000"):
        read_calibration(tmp_path / "long.yaml")
    with pytest.raises(ConfigError, match=r"unwrap.file must be a path"):
        Preprocessing.checked((64, 256), {"kind": "calibrated"})
