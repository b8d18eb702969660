"""Two descriptors based on the Radon transform of an omnidirectional image ([T] 3.2.6, 3.3.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import AlignedDescriptor, Cells, ImageDescriptor, divisors_near
from analytic.descriptors.radon_transform import Even, Source, Step, check_square, harmonics, orientations, steps
from analytic.errors import AnalyticError

_LEAST = 1e-9  # of the largest magnitude: a coefficient below it is rounding error and is not scaled to length 1


@dataclass(frozen=True, kw_only=True)
class RadonFourier(ImageDescriptor):
    """The Fourier signature of the Radon transform: its magnitudes for the position, its phases for the heading.

    Let r (T, size / 2), T = 360 / step, be the Radon transform that `analytic.descriptors.radon_transform` defines,
    half lines at the distances 1/2, 3/2, ... pixels. The columns retained are means of lines, which leave no part of
    the disc out: with n = size / 2 / lines, q[t, k] is the mean of r[t, k n ... k n + n - 1]. The signature is the
    discrete Fourier transform along the orientations, in which a turn only changes phases:

        c[u, k] = (1 / T) sum_t q[t, k] exp(-2 pi i u t / T),    u = 0 ... T - 1.

    Position (T * lines,): value u * lines + k is |c[u, k]|. As q is real, the values of u and T - u are equal; both are
    kept, so that the size is the one of [T] table 3.2. Those above the frequencies of the transform are 0.
    Orientation (T, orientation_lines): the matrix with the same phases but no magnitudes, from the mean lines of
    `orientation_lines`: value [t, k] is

        p[t, k] = (1 / T) sum_u g[u, k] exp(2 pi i u t / T),    g = c[u, k] / max(|c[u, k]|, 1e-9 max over u |c[u, k]|),

    and 0 for a line of zeros. It moves by one along t when the robot turns left by `step` degrees, and its circular
    correlation is that of the phases of [T] 3.3.1. With the magnitudes left in, the slow changes that an occlusion
    adds would dominate.

    The default distance is Manhattan's, with which [T] 3.5.1 has its best result. A turn by any number of columns
    leaves the position part unchanged; one that is not a multiple of `step` is found to within half a step.

    With `circular=False` each row of a panorama is first extended by its mirror image, and there is no heading.

    Args:
        step: degrees between orientations, p1 of [T] table 3.1; divides 360, at most 120. It is the angular resolution.
        size: side of the omnidirectional image in pixels, Nx; even.
        lines: columns retained in the position part, k11; divides size / 2.
        orientation_lines: columns retained in the orientation part, k12; divides size / 2.
        source: "panorama", wrapped back to a disc, or "omnidirectional", square images.

    Raises:
        AnalyticError: a step that does not divide 360, an odd size, lines that do not divide half of it, an unknown
            source.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> radon_fourier = analytic.descriptor("radon_fourier", step=4.5, size=64)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = radon_fourier.describe(panoramas), radon_fourier.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(radon_fourier.relative_heading(turned, known))
        array([-90., -90.])
    """

    name: ClassVar[str] = "radon_fourier"
    default_distance: ClassVar[str] = "manhattan"

    step: Step = 1.0
    size: Even = 256
    lines: Cells = 32
    orientation_lines: Cells = 32
    source: Source = "panorama"

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the sizes (360 / p1, k11) and (360 / p1, k12) of [T]; the parts are (B, 360 / p1 * k11) and
        (B, 360 / p1, k12)."""
        return (steps(self.step), self.lines), (steps(self.step), self.orientation_lines)

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("lines", "orientation_lines"):
            value, half = getattr(self, key), self.size // 2
            if half % value:
                raise AnalyticError(
                    f"radon_fourier's {key}={value} must divide the {half} lines of size={self.size}: use "
                    f"{key}={divisors_near(half, value)}"
                )

    def _check_size(self, height: int, width: int) -> None:
        check_square(self.name, self.source, height, width)

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        count = steps(self.step)
        kept = harmonics(image, self.step, self.size, self.lines, self.source, self.circular)
        magnitude = np.abs(kept)
        position = np.zeros((count, self.lines), dtype=np.float32)
        position[: len(kept)] = magnitude
        position[count - len(kept) + 1 :] = magnitude[:0:-1]
        if self.orientation_lines != self.lines:
            kept = harmonics(image, self.step, self.size, self.orientation_lines, self.source, self.circular)
        phases = _phases(kept, axis=0)
        return position.reshape(-1), (orientations(phases, count) / count).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class RadonPoc(AlignedDescriptor):
    """The Radon transform, compared by phase-only correlation: the peak is the similarity, its place the heading.

    Let r (T, N), T = 360 / step and N = size / 2, be the Radon transform that `analytic.descriptors.radon_transform`
    defines, and F[u, v] its two-dimensional discrete Fourier transform. Phase-only correlation of a query Q and a
    reference R is the inverse transform of their product without magnitudes, Q conj(R) / (|Q| |R|). As turning the
    robot moves r along its orientations alone, no other shift is considered: the correlation for a turn by s steps is

        poc[s] = (1 / A) sum over u, v of gQ[u, v] conj(gR[u, v]) exp(2 pi i u s / T),
        g[u, v] = F[u, v] / max(|F[u, v]|, 1e-9 max |F|),

    where 1 / A makes that of an image with itself 1 at s = 0: A = sqrt(sum |gQ|^2 sum |gR|^2). Frequencies u that the
    transform does not contain (it is limited to |u| <= M) are 0 and add nothing.

    Each factor g depends on one image alone. A description therefore holds the matrix of phases, which is
    x = inverse transform of g, divided by its Euclidean length; zeros for a black image. By Parseval's theorem poc[s]
    is the circular correlation of two of them along the orientations, sum over t, k of xQ[t, k] xR[t - s, k].

    Position (T * N,): value t * N + k is x[t, k]. Orientation (T, N): the same matrix.
    The distance is 1 - max over s of poc[s], in [0, 2]: "cosine" at the best turn, as the lengths are 1. Other
    distances are computed at that turn.

    Turns by multiples of `step` leave the distances unchanged. Turns by other angles lower the peak, and are found
    to within half a step.

    With `circular=False` each row of a panorama is first extended by its mirror image, only s = 0 is compared, and
    there is no heading.

    Args:
        step: degrees between orientations, p1 of [T] table 3.1; divides 360, at most 120. It is the angular resolution.
        size: side of the omnidirectional image in pixels, Nx; even.
        source: "panorama", wrapped back to a disc, or "omnidirectional", square images.

    Raises:
        AnalyticError: a step that does not divide 360, an odd size, an unknown source.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> radon_poc = analytic.descriptor("radon_poc", step=4.5, size=64)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = radon_poc.describe(panoramas), radon_poc.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(radon_poc.relative_heading(turned, known))
        array([-90., -90.])
    """

    name: ClassVar[str] = "radon_poc"
    default_distance: ClassVar[str] = "cosine"

    step: Step = 4.0
    size: Even = 256
    source: Source = "panorama"

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (360 / p1, Nx / 2) for both parts; they are (B, 360 / p1 * Nx / 2) and (B, 360 / p1, Nx / 2)."""
        return (steps(self.step), self.size // 2), (steps(self.step), self.size // 2)

    def _check_size(self, height: int, width: int) -> None:
        check_square(self.name, self.source, height, width)

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        kept = harmonics(image, self.step, self.size, self.size // 2, self.source, self.circular)
        phases = _phases(np.fft.fft(kept, axis=1), axis=None)
        matrix = orientations(np.fft.ifft(phases, axis=1), steps(self.step))
        matrix = (matrix / max(np.linalg.norm(matrix), np.finfo(np.float64).tiny)).astype(np.float32)
        return matrix.reshape(-1), matrix


def _phases(values: NDArray[np.complex128], axis: int | None) -> NDArray[np.complex128]:
    """Return values divided by their magnitudes, or by 1e-9 of the largest along an axis where they are smaller."""
    size = np.abs(values)
    least = np.maximum(_LEAST * size.max(axis=axis, keepdims=True), np.finfo(np.float64).tiny)
    return np.asarray(values / np.maximum(size, least))
