"""The configuration of a study: one question, what is varied to answer it, and how finely."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from huesphere.configs.errors import InputError
from huesphere.configs.load import PACKAGED, anchor_paths, apply_override, find_config, is_study, read_yaml
from huesphere.configs.model import Model
from huesphere.configs.suggest import closest

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels from the top left, ends excluded


class Photograph(Model):
    """The report's section 4.2: a region of a photograph, the region around it, and what to compare it with."""

    picture: str = Field(default="astronaut.png", description="a photograph in scikit-image, or a path")
    region: Box = (186, 108, 256, 138)
    larger: Box = (180, 76, 264, 182)
    others: tuple[str, ...] = Field(default=(), description="ordinary photographs that patches are drawn from")
    patches: int = Field(default=40, ge=4, description="from each")
    side: int = Field(default=48, ge=16, description="of a patch, pixels")
    seed: int = 0


class Report1994(Model):
    """Every claim and figure of the report."""

    study: Literal["report_1994"]
    scene: str = Field(default="mozart_5lights.yaml", description="the config of the report's synthetic picture")
    room: str = Field(default="room_coloured_walls.yaml", description="the config in which walls are the only lights")
    scan: str | None = Field(default=None, description="a depth map to repeat Figs. 1 and 2 on")
    resolution: int = Field(default=256, ge=48)
    traced_resolution: int = Field(default=80, ge=32, description="of the pictures with interreflection")
    target_rms: float = Field(default=4e-3, gt=0, description="of the pictures with interreflection")
    trials: int = Field(default=40, ge=5, description="of what is repeated with other noise or other rotations")
    photograph: Photograph = Photograph()


class OneBounce(Model):
    """One bounce against all of them: shapes × lights × albedos, each a picture in four transports."""

    study: Literal["one_bounce"]
    base: dict[str, Any] = Field(description="keys of a scene's config that all have in common")
    shapes: dict[str, dict[str, Any]] = Field(description="name → keys of a scene's config; the first one is convex")
    lights: dict[str, list[dict[str, Any]]]
    albedos: tuple[Annotated[float, Field(gt=0, lt=1)], ...] = Field(min_length=1)
    methods: tuple[str, ...] = Field(min_length=1)
    slow_methods: tuple[str, ...] = Field(default=(), description="run on full only")
    maps: tuple[str, str, float] = Field(description="shape, lights, albedo of the pictures shown")
    enough_deg: float = Field(default=1.0, gt=0, description="the change in an error that counts as none")


class Curve(Model):
    """One assumption and how far it is broken."""

    title: str
    axis: str = Field(description="what is varied, with its unit")
    key: str = Field(description="a key of the scene's config, or one of the settings in eval/studies/breaking.py")
    values: tuple[Any, ...] = Field(min_length=2)
    x: Literal["cond_F", "highlight_share", "sees_all", "indirect"] | None = Field(
        default=None, description="show on the axis what is measured in the picture, in place of the value"
    )
    scale: float = Field(default=1.0, description="of the axis")
    log: bool = Field(default=False, description="logarithmic axis")
    noise: float | None = Field(default=None, ge=0, description="read noise in place of the base's")


class Assumptions(Model):
    """Error against each broken assumption, one curve each."""

    study: Literal["assumptions"]
    base: dict[str, Any]
    methods: tuple[str, ...] = Field(min_length=1)
    curves: dict[str, Curve] = Field(min_length=1)
    tolerance_deg: float = Field(default=5.0, gt=0, description="the error at which an assumption counts as broken")


class RealPhotographs(Model):
    """Every set of photographs in a folder × kinds of lights × seeds × methods, and what limits each."""

    study: Literal["real_photographs"]
    path: str | None = Field(default=None, description="a folder of sets; null: the study is skipped")
    lights: tuple[Literal["lamps", "gels", "natural"], ...] = Field(min_length=1)
    mixes: int = Field(default=3, ge=1, le=1000, description="seeds of each set and kind of lights")
    reduce: int = Field(default=2, ge=1, le=16, description="means over squares of so many pixels a side")
    methods: tuple[str, ...] = Field(min_length=1)
    causes_method: str = Field(description="the method that is given pictures without one cause each")


AnyStudy = Report1994 | OneBounce | Assumptions | RealPhotographs
StudyConfig = Annotated[AnyStudy, Field(discriminator="study")]
KINDS = ("report_1994", "one_bounce", "assumptions", "real_photographs")


def load_study(name_or_path: str, *, overrides: list[str] | tuple[str, ...] = ()) -> AnyStudy:
    """Read a study's config and apply overrides. Raises InputError for anything that is wrong."""
    try:
        path = find_config(name_or_path)
    except InputError:
        near = closest(Path(name_or_path).stem, packaged_studies())
        hint = f"did you mean {near}? " if near else ""
        known = ", ".join(packaged_studies())
        raise InputError(f"no such study; {hint}packaged are {known}", where=name_or_path) from None
    data, _ = read_yaml(path)
    if "study" not in data:
        raise InputError("not a study: it has no key 'study'", expected=f"one of {', '.join(KINDS)}", where=path)
    data = anchor_paths(data, path.parent)
    for assignment in overrides:
        apply_override(data, assignment)
    data = anchor_paths(data, Path())
    try:
        return TypeAdapter(StudyConfig).validate_python(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"] if part not in KINDS) or "study"
        raise InputError(f"{key}: {first['msg']}", got=repr(first["input"])[:60], where=path) from None


def packaged_studies() -> list[str]:
    """Names of the studies that ship with huesphere."""
    return sorted(path.name for path in PACKAGED.glob("*.yaml") if is_study(path))
