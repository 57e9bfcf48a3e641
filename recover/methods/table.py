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
    """A method: call it with an observation and it returns an estimate, whatever happens."""

    name: str
    function: str  # "module:function" in this package, from an observation to an estimate
    does: str  # one sentence
    # "module:function" of what is asked where the estimate, judged, is not to be trusted; None: nothing
    second_opinion: str | None = None

    def load(
        self,
    ) -> "Callable[[huesphere.render.dataset.Observation], huesphere.recover.io.estimate.Estimate]":
        """The function itself, from a picture in linear light to an estimate that is not judged yet."""
        return _loaded(self.function)  # type: ignore[no-any-return]

    def __call__(
        self, observation: "huesphere.render.dataset.Observation", most_pixels: int | None = None
    ) -> "huesphere.recover.io.estimate.Estimate":
        """The estimate of the picture: decoded to linear light first, on one thread of linear algebra.

        ``most_pixels``: of the object, above which what is global is found on a reduced picture; None: as
        ``recover.full_size`` has it.
        """
        from huesphere.recover.methods.calling import estimate_by

        otherwise = None if self.second_opinion is None else _loaded(self.second_opinion)
        return estimate_by(self.name, self.load(), observation, most_pixels, otherwise)


def _loaded(name: str) -> Any:
    """What "module:function" names in this package."""
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
        Method("drew-kontsevich-ambient", "report:recover_with_ambient", "The same with the report's ambient term."),
        Method("alternation", "report:recover_by_alternation", "The same with the rotation of the report's 3.5."),
        Method(
            "weak-integrability", "weak:recover_weak_integrability", "The ellipsoid refitted; rotation in weak form."
        ),
        Method("robust", "robust:recover_robust", "Finds the ellipsoid where under half the pixels are on it."),
        Method("unbounce", "every_pixel:recover_unbounced", "Interreflection removed first, and the albedos it tells."),
        Method("knit", "every_pixel:recover_knitted", "Lights from their shadows, and every pixel by those it sees."),
        Method("joint", "every_pixel:recover_jointly", "The same, then depth and F fitted together: for noise."),
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
        Method("kontsevich-1994-growing", "kontsevich:recover_by_growing", "An ellipsoid by region growing instead."),
    )
}


def check_methods(methods: Sequence[str], *, where: str = "--method") -> None:
    """Raise InputError for a name that is no method, with the nearest that is."""
    for name in methods:
        if name not in METHODS:
            expected = suggested(name, METHODS, f"one of {', '.join(METHODS)}")
            raise InputError("no such method", got=name, expected=expected, where=where)
