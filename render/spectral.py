"""From light transport and spectra to colour: all dependence on wavelength is in one small matrix of integrals.

Light of source i that arrives at a surface point has the spectrum E_i(λ) φ(λ), where φ is the product of the
reflectances that it met on its way. The surface multiplies it by its own reflectance S(λ), the camera weights it by its
sensitivities Q(λ). The transport is one image for each source and each φ, so colours are these images times the
integrals ∫ E_i φ S Q dλ, and wavelengths need no sampling.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from huesphere.scenes.build import RoughMatte, Scene
from huesphere.scenes.spectra import STEP

NODE_TOLERANCE = 1e-5  # relative error of the interpolation in wavelength
NODE_DEGREE = 12  # most factors of the products of reflectances that are interpolated to that tolerance
NODE_TRIALS = 600  # random products on which the nodes are chosen


@dataclass(frozen=True)
class Components:
    """The products of reflectances φ that light can have met before it arrives, in the order of the transport's images.

    W wavelengths, those of ``scenes.spectra``.
    """

    names: tuple[str, ...]  # "direct", "one_bounce", "rest2" …; with several reflectances "one_bounce.1", "rest.0" …
    basis: np.ndarray  # (C, W) φ of each component; 1 for the first, direct light
    highlights: tuple[str, ...] = ()  # components that the seen surface reflects by its coat, without its reflectance S
    nodes: tuple[int, ...] = ()  # numbers of the wavelengths at which the components "rest.0", "rest.1" … are computed


def components_by_order(surface: np.ndarray, orders: int) -> Components:
    """The components of a scene with one reflectance S, ``surface`` (W,): φ = S^k, k = 0 … ``orders``."""
    names = ["direct", "one_bounce", *(f"rest{k}" for k in range(2, orders + 1))][: orders + 1]
    return Components(tuple(names), surface[None] ** np.arange(orders + 1)[:, None])


def components_by_material(reflectances: np.ndarray, reflecting: Sequence[int], *, rest: bool) -> Components:
    """The components of a scene with several reflectances (M, W), of which those numbered ``reflecting`` reflect light.

    Direct light, light that each of them reflected once, and, with ``rest``, all later light at the nodes.
    """
    surfaces = reflectances[list(reflecting)]
    names, basis = ["direct", *(f"one_bounce.{m}" for m in reflecting)], [np.ones((1, surfaces.shape[1])), surfaces]
    if not rest:
        return Components(tuple(names), np.concatenate(basis))
    nodes, cardinal = wavelength_nodes(surfaces)
    names += [f"rest.{j}" for j in range(len(nodes))]
    return Components(tuple(names), np.concatenate([*basis, cardinal]), nodes=tuple(int(node) for node in nodes))


def wavelength_nodes(reflectances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A few wavelengths from which products of reflectances are interpolated: (indices (J,), cardinals (J, W)).

    Any product of the ``reflectances`` (M, W) is the sum of its values at the J nodes times the cardinal functions,
    within NODE_TOLERANCE. They are an interpolative decomposition of many random products, by QR with column pivoting.
    Reflectances are smooth in λ, so few nodes suffice; the line spectra of emitters enter only afterwards.
    """
    rng = np.random.default_rng(0)
    powers = [np.eye(len(reflectances)) * k for k in range(1, NODE_DEGREE + 1)]
    shares = rng.dirichlet(np.full(len(reflectances), 0.5), NODE_TRIALS)
    mixed = np.round(shares * rng.integers(1, NODE_DEGREE + 1, (NODE_TRIALS, 1)))
    exponents = np.unique(np.concatenate([np.zeros((1, len(reflectances))), *powers, mixed]), axis=0)
    products = np.exp(exponents @ np.log(np.maximum(reflectances, 1e-12)))
    _, triangle, order = qr(products, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    count = int(np.sum(size > NODE_TOLERANCE * size[0]))
    cardinal = np.empty((count, reflectances.shape[1]))
    cardinal[:, order] = np.concatenate(
        [np.eye(count), solve_triangular(triangle[:count, :count], triangle[:count, count:])], axis=1
    )
    return order[:count], cardinal


def component_colours(scene: Scene, components: Components) -> np.ndarray:
    """Colour of each source, component and seen material of ``scene``, (L, C, M, 3); see `component_colours_of`."""
    emitters = np.stack([light.spectrum for light in scene.lights])
    return component_colours_of(emitters, components, scene.reflectances, scene.sensitivity)


def component_colours_of(
    emitters: np.ndarray, components: Components, reflectances: np.ndarray, sensitivity: np.ndarray
) -> np.ndarray:
    """∫ E_i φ_c S_m Q dλ, λ in nm, (L, C, M, 3): camera units.

    ``emitters`` (L, W), ``reflectances`` (M, W), ``sensitivity`` (W, 3). For direct light on the object this is the
    report's b_i, Eq. (3).
    """
    last = np.repeat(reflectances[None], len(components.names), axis=0)
    last[[name in components.highlights for name in components.names]] = 1.0
    lights = emitters[:, :, None] * sensitivity[None]  # (L, W, 3)
    paths = components.basis[:, None] * last  # (C, M, W)
    return np.einsum("cmw,lwk->lcmk", paths, lights, optimize=True) * STEP


@dataclass(frozen=True)
class Seen:
    """The reflectances that n pixels see."""

    material: np.ndarray  # (n,) int, number of the reflectance
    weights: np.ndarray | None  # (n, M) of each reflectance where it varies over faces; None: 1 for the material

    def take(self, chosen: np.ndarray) -> "Seen":
        """Those of the pixels that ``chosen``, a mask or indices, selects."""
        return Seen(self.material[chosen], None if self.weights is None else self.weights[chosen])


def has_own_colour(name: str) -> bool:
    """Whether light of the component ``name`` has not been multiplied by the reflectance of the surface that is seen.

    So it is with light off a coat, and with images that are colours already.
    """
    return name.startswith("highlight") or name.endswith((".R", ".G", ".B"))


def colour_of(images: np.ndarray, colours: np.ndarray, seen: Seen, names: Sequence[str] = ()) -> np.ndarray:
    """Colour (n, 3) of pixels from images (L, C, n), ``component_colours`` (L, C, M, 3) and what the pixels see.

    The unit is that of ``colours``. ``names`` (C) of the components, needed only if some of them have a colour of their
    own.
    """
    out = np.zeros((images.shape[2], 3))
    if seen.weights is not None:
        own = np.zeros(images.shape[1], bool)
        own[: len(names)] = [has_own_colour(name) for name in names]
        for number in np.flatnonzero(seen.weights.any(axis=0)):
            part = np.einsum("lcn,lck->nk", images[:, ~own], colours[:, ~own, number], optimize=True)
            out += seen.weights[:, number, None] * part
        return out + np.einsum("lcn,lck->nk", images[:, own], colours[:, own, 0], optimize=True)
    for number in np.unique(seen.material):
        pixels = seen.material == number
        out[pixels] = np.einsum("lcn,lck->nk", images[:, :, pixels], colours[:, :, number], optimize=True)
    return out


def linear_model(scene: Scene) -> np.ndarray | None:
    """F = B A of Eqs. (3)–(6), (3, 3): colour of a pixel that sees every light, before exposure, ρ = F n.

    None where the report's model does not hold: a source whose shading is no a·n (`Light.shading`; ambient light adds
    to the model and leaves F as it is), an object of several reflectances, or a rough matte one. Where the
    brightness of one reflectance varies, F is that of factor 1.
    """
    shading = [light.shading for light in scene.lights]
    rows = [(light, a) for light, a in zip(scene.lights, shading, strict=True) if a is not None and a.any()]
    if any(a is None for a in shading) or not rows or scene.is_object.sum() != 1 or isinstance(scene.coat, RoughMatte):
        return None
    surface = scene.reflectances[int(np.flatnonzero(scene.is_object)[0])]
    B = np.stack([(light.spectrum * surface) @ scene.sensitivity * STEP for light, _ in rows], axis=1)  # Eqs. (3), (5)
    A = np.stack([a for _, a in rows])  # Eq. (5): one row a light
    return B @ A  # Eq. (6)
