"""Methods over pictures by path: a first answer at once, then the methods asked for, one folder and page a picture."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from huesphere.configs.errors import InputError
from huesphere.configs.threads import one_blas_thread
from huesphere.recover.full_size.picture import reduced
from huesphere.recover.geometry.reduction import reduction_of
from huesphere.recover.io.estimate import Estimate, write_estimate
from huesphere.recover.io.object_finding import FoundObject, find_object
from huesphere.recover.io.page import angle_between, two_digits, write_sheet
from huesphere.recover.io.picture import PictureRead, ReadOptions, open_picture
from huesphere.recover.io.picture_folder import claim_folder, folder_name, in_order, remove_images
from huesphere.recover.methods.table import check_methods
from huesphere.recover.run import (
    DEFAULT_METHODS,
    Report,
    describe,
    has_depth,
    recover_one,
    require_focal_length,
    with_depth,
)
from huesphere.recover.stages import told_to
from huesphere.render.dataset import Observation, linear_light
from huesphere.render.jobs import Lost, Progress, each

NO_PROOF = (
    "An ellipsoid that fits does not show that the lights were of several colours: many an ordinary photograph fits "
    "one. Hold the surface against a shape that you know."
)
NOTHING = "There are no normals: what failed, and what would help, is in the lines above and on the page."

QUICK = "weak-integrability"  # the method of first answers, and by which two readings of a picture are compared …
QUICK_PIXELS = 10_000  # … on a picture of at most so many object pixels
SLOW = ("auto", "robust", "unbounce", "knit", "joint")  # methods that a first answer is given before

# Object pixels above which a picture is reduced to find what is global; None: as ``recover.full_size`` has it.
EFFORTS: dict[str, int | None] = {"quick": QUICK_PIXELS, "normal": None, "thorough": 10**12}

Shown = Callable[[str], AbstractContextManager[Progress]]  # something that shows progress, made from a title


@contextmanager
def unseen(title: str) -> Iterator[Progress]:
    """Shows no progress."""
    yield lambda share, what: None


@dataclass(frozen=True)
class _Asked:
    """A picture, and what is to be done with it."""

    path: Path
    folder: Path
    methods: tuple[str, ...]
    region: tuple[int, int, int, int] | None
    mask: Path | None
    encoding: str
    options: ReadOptions
    depth: bool
    overwrite: bool
    effort: str

    def read(self, encoding: str) -> PictureRead:
        """The picture, its samples taken to have the ``encoding``."""
        return open_picture(self.path, region=self.region, mask=self.mask, encoding=encoding, options=self.options)


# More than seven parameters: they are the options of the command, each on its own.
def recover_picture(
    path: Path,
    methods: Sequence[str] = (),
    *,
    region: tuple[int, int, int, int] | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    depth: bool = False,
    overwrite: bool = False,
    effort: str = "normal",
    report: Report | None = None,
    shown: Shown = unseen,
) -> Path:
    """Run the methods on one picture; returns the folder written.

    In it: observation.exr, estimates/<method>.exr and .json with depth, report.html and its images. There is no depth
    of pictures in perspective of unknown focal length; ``depth`` asks for it all the same, and is refused. The folder
    is ``out``, or is named by ``folder_name``. Estimates of the same picture that are there stay, and are on the
    page too; ``overwrite`` makes them again, and removes those of another picture. Before a slow method, QUICK gives a
    first answer from a small picture, with a page, which is replaced later. ``effort``: one of EFFORTS. ``report`` is
    called with lines for the user, and ``shown`` shows how far a method is. Raises InputError.
    """
    folder = out if out is not None else Path(folder_name(path, region))
    asked = _Asked(path, folder, tuple(methods), region, mask, encoding, options, depth, overwrite, effort)
    _recover(asked, report or (lambda line: None), shown)
    return folder


# More than seven parameters: they are the options of the command, each on its own.
def recover_pictures(
    paths: Sequence[Path],
    methods: Sequence[str] = (),
    *,
    region: tuple[int, int, int, int] | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    depth: bool = False,
    overwrite: bool = False,
    effort: str = "normal",
    jobs: int = 1,
    report: Report = lambda line: None,
    progress: Progress = lambda share, what: None,
) -> list[Path]:
    """Run the methods on several pictures, in ``jobs`` processes; returns the folders written, in their order.

    Each is in ``out``, or here, named by ``folder_name``; arguments as of ``recover_picture``. There are no first
    answers. A picture that cannot be read does not stop the others: InputError is raised at the end.
    """
    check_methods(methods)
    folders = [(out or Path()) / folder_name(path, region) for path in paths]
    for number, folder in enumerate(folders):
        if folder in folders[:number]:
            both = f"{paths[folders.index(folder)]} and {paths[number]}"
            raise InputError("two pictures of one name, whose results would share a folder", got=both)
    work = [
        _Asked(path, folder, tuple(methods), region, mask, encoding, options, depth, overwrite, effort)
        for path, folder in zip(paths, folders)
    ]
    faults = []
    with closing(each(_of_several, work, jobs=jobs, scheduler=None, progress=progress, log=report)) as results:
        for number, fault in results:
            if isinstance(fault, Lost):
                faults.append(f"{paths[number]}: {fault.why}")
            elif fault:
                faults.append(fault)
    if faults:
        more = f" (and {len(faults) - 1} more pictures)" if len(faults) > 1 else ""
        raise InputError(f"{min(faults)}{more}")
    return folders


def _of_several(asked: _Asked, progress: Progress, log: Report) -> str:
    """Run the methods on one of several pictures; bad input is told as text, else the text is empty."""
    lines: list[str] = []
    progress(0.0, asked.path.name)
    try:
        _recover(asked, lines.append, unseen, first_answer=False)
    except InputError as error:
        return str(error)
    log("\n".join(lines))
    return ""


def _recover(asked: _Asked, report: Report, shown: Shown, *, first_answer: bool = True) -> None:
    check_methods(asked.methods)
    read, found = _with_object(asked.read(asked.encoding))
    observation = read.observation
    if asked.depth:
        require_focal_length(observation, asked.path)
    report(read.how)
    if found is not None:
        report(found.said)
    there = claim_folder(asked.folder, observation, overwrite=asked.overwrite)
    kept = set() if asked.overwrite else {estimate.method for estimate in there}
    wanted = [method for method in asked.methods or DEFAULT_METHODS if method not in kept]
    if not wanted:
        raise InputError("there are estimates already (--overwrite makes them again)", where=asked.folder)
    title = f"{asked.path.name}: normals from one picture"
    if first_answer and wanted[0] in SLOW:
        _answer_first(asked, read, wanted[0], report, title)
    estimates: list[Estimate] = []
    for method in wanted:
        with shown(f"{asked.path.name} {method}") as progress, told_to(progress):
            estimate = recover_one(observation, method, EFFORTS[asked.effort])
            estimate = _with_depth(estimate, observation)
        remove_images(asked.folder, method)  # of an earlier run, or of the first answer
        write_estimate(asked.folder / "estimates", estimate, asked.folder / "observation.exr")
        estimates.append(estimate)
        report(describe(asked.path.name, estimate))
    best = next((e for e in estimates if e.valid.any()), estimates[0])
    notes = encoding_notes(read, best, lambda other: replace(asked.read(other).observation, mask=observation.mask))
    given = any(estimate.valid.any() for estimate in estimates)
    if given and not observation.camera.known:
        notes.append(NO_PROOF)
    for note in notes if given else [*notes, NOTHING]:
        report(note)
    notes = [_sentence(found.said), *notes] if found is not None else notes
    write_sheet(asked.folder, title, read.how, observation, in_order(estimates, there), notes)


def _with_object(read: PictureRead) -> tuple[PictureRead, FoundObject | None]:
    """(the picture with its object, what was found); None where user or file say which pixels are the object."""
    if not read.unmasked:
        return read, None
    found = find_object(read.observation.rgb)
    if found.mask is None:
        return read, found
    return replace(read, observation=replace(read.observation, mask=found.mask)), found


def _sentence(line: str) -> str:
    """A line for the terminal as a sentence for the page."""
    return f"{line[0].upper()}{line[1:]}."


def _answer_first(asked: _Asked, read: PictureRead, method: str, report: Report, title: str) -> None:
    """Report the answer of QUICK on a small picture, and write a page of it with the images of ``method``."""
    small = _small(read.observation)
    first = recover_one(small, QUICK)
    report(f"first answer, on a picture of {small.mask.sum():,} pixels, while {method} is at work:")
    report(describe(asked.path.name, first))
    shown = replace(_with_depth(first, small), method=method)
    note = f"First answer, by {QUICK} on a small picture. {method} is at work, and its result will replace it."
    write_sheet(asked.folder, title, read.how, small, [shown], [note])


def _with_depth(estimate: Estimate, observation: Observation) -> Estimate:
    """The estimate with depth, where the picture can have one; the same bytes whatever the number of threads."""
    if not has_depth(observation):
        return estimate
    with one_blas_thread():
        return with_depth(estimate, observation)


def encoding_notes(read: PictureRead, estimate: Estimate, read_as: Callable[[str], Observation]) -> list[str]:
    """What hangs on how the samples were taken to be encoded, in sentences.

    Both readings are compared on a reduced picture, by QUICK: what the encoding changes, it changes for every method
    and at every size. ``read_as`` reads the picture again as "srgb" or "linear". Nothing for pictures of which no other
    reading is possible: those of run folders, and raw files.
    """
    camera = read.observation.camera
    if camera.known or read.certain:
        return []
    other = "linear" if camera.stored_as == "srgb" else "srgb"
    if other == "srgb" and camera.bits is None and read.observation.rgb.max() > 1:
        return ["Values above 1: taken as linear, which display-encoded samples cannot be."]
    taken, again = (recover_one(_small(one), QUICK) for one in (read.observation, read_as(other)))
    decoded = f"decoded as {read.encoded}", "taken as linear"
    assumed, otherwise = decoded if other == "linear" else ("linear", "sRGB")
    note = f"Encoding: the samples were {'taken to be ' * (other == 'srgb')}{assumed}; had they been {otherwise}, "
    turn = angle_between(taken, again)
    if turn is not None:
        note += f"the normals would differ by {two_digits(turn)}° (median, by {QUICK} on a small picture)"
        note += f" and the status would be {again.status}" if again.status != taken.status else ""
    elif again.status == taken.status:
        note += f"{QUICK} would end with {again.status} as well"
    else:
        note += f"{QUICK} would end with {again.status}, now it ends with {taken.status}"
    note += ". Colour is linear in the normal only in linear samples: where you can, give raw data."
    if read.guessed and again.verdict == "trust" and "trust" not in (taken.verdict, estimate.verdict):
        note += f" THE GUESS IS PROBABLY WRONG: --encoding {other} ends with {again.status}."
    elif read.guessed:
        note += " That they are so is a guess, because the file does not say: give --encoding."
    return [note]


def _small(observation: Observation) -> Observation:
    """The observation in linear light, of at most QUICK_PIXELS object pixels."""
    linear = linear_light(observation)
    by = reduction_of(linear.mask, QUICK_PIXELS)
    return linear if by is None else reduced(linear, by)
