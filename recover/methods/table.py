"""The methods by name. Adding one is a file with its function, and one line here (docs/extend.md).

The commands' help, the documentation's list and the tests take names and sentences from this table. It imports no
numerical library: a method's module is loaded when the method is called.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from huesphere.configs.errors import InputError
from huesphere.configs.suggest import suggested

if TYPE_CHECKING:
    from collections.abc import Callable

    # Whole names: the documentation finds two targets for the short ones, here and in `huesphere`.
    import huesphere.recover.io.estimate
    import huesphere.render.dataset


@dataclass(frozen=True)
class Method:
    """A method: called with an observation it returns an estimate.

    A recovery that fails is a status of the estimate, not an exception. Faults of the program and of memory are raised.
    """

    name: str
    function: str  # "module:function" in the package recover.methods, from an observation to an estimate
    does: str  # one sentence
    # "module:function" in that package: the function that gives another estimate where the verdict on this one is not
    # "trust"; None: there is none
    second_opinion: str | None = None

    def load(
        self,
    ) -> "Callable[[huesphere.render.dataset.Observation], huesphere.recover.io.estimate.Estimate]":
        """The function itself, from a picture in linear light to an estimate that is not judged yet."""
        return _loaded(self.function)  # type: ignore[no-any-return]

    def __call__(
        self, observation: "huesphere.render.dataset.Observation", most_pixels: int | None = None
    ) -> "huesphere.recover.io.estimate.Estimate":
        """The judged estimate of the picture, which is decoded to linear light first.

        Linear-algebra libraries (BLAS) use one thread meanwhile. ``most_pixels``: the number of object pixels above
        which the picture is averaged over blocks, the estimate is made on the smaller picture and then taken back to
        full size; None: MOST_PIXELS of ``recover.full_size.picture``.
        """
        from huesphere.recover.methods.calling import estimate_by

        otherwise = None if self.second_opinion is None else _loaded(self.second_opinion)
        return estimate_by(self.name, self.load(), observation, most_pixels, otherwise)


def _loaded(name: str) -> Any:
    """The function that "module:function" names in the package recover.methods."""
    module, _, function = name.partition(":")
    return getattr(import_module(f"{__package__}.{module}"), function)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "auto",
            "auto:recover_automatically",
            "The steps that the picture calls for, and every pixel.",
            second_opinion="second_opinion:with_free_brightness",
        ),
        Method("least-squares", "report:recover_least_squares", "All pixels on one ellipsoid: the baseline."),
        Method("drew-kontsevich", "report:recover_drew_kontsevich", "The report's own method of 1994."),
        Method(
            "drew-kontsevich-ambient",
            "report:recover_with_ambient",
            "As drew-kontsevich, with the report's ambient term.",
        ),
        Method(
            "alternation", "report:recover_by_alternation", "As drew-kontsevich, with the rotation of the report's 3.5."
        ),
        Method(
            "weak-integrability", "weak:recover_weak_integrability", "The ellipsoid refitted; rotation in weak form."
        ),
        Method("robust", "robust:recover_robust", "Finds the ellipsoid where under half the pixels are on it."),
        Method(
            "unbounce",
            "every_pixel:recover_unbounced",
            "Removes interreflection first, and estimates the albedo from it.",
        ),
        Method(
            "knit",
            "every_pixel:recover_knitted",
            "Finds the lights from their shadows, then gives every pixel the normal for the lights that it sees.",
        ),
        Method("joint", "every_pixel:recover_jointly", "As knit, then fits depth and F together; for noisy pictures."),
        Method(
            "uniform-hue",
            "uniform_hue:recover_of_uniform_hue",
            "One hue, any brightness: integrable directions of colours, silhouette and albedo.",
        ),
        Method(
            "silhouette-matrix",
            "silhouette_matrix:recover_by_silhouette_matrix",
            "Any brightness: one matrix from colours to the normals of the inflated silhouette.",
        ),
        Method("kontsevich-1994", "kontsevich:recover_kontsevich_1994", "The report's ellipsoid, random rotations."),
        Method(
            "kontsevich-1994-growing",
            "kontsevich:recover_by_growing",
            "As kontsevich-1994, with the ellipsoid found by region growing.",
        ),
    )
}


def check_methods(methods: Sequence[str], *, where: str = "--method") -> None:
    """Raise InputError for a name that is no method, with the nearest that is."""
    for name in methods:
        if name not in METHODS:
            expected = suggested(name, METHODS, f"one of {', '.join(METHODS)}")
            raise InputError("no such method", got=name, expected=expected, where=where)
