"""Our table against public evaluators run as they are, on the same normal maps: the largest difference.

python benchmarks/eval_against_public.py ROBUST_PHOTOMETRIC_STEREO DSINE     folders of clones; neither is a package

They are yasumat's RobustPhotometricStereo and baegwangbin's DSINE, by these names on GitHub.
Prints what tests/test_eval_against_public.py holds as THEIRS. OpenCV and PyTorch, which the clones import, are of no
use to the two functions that are called, and need not be installed.
"""

import importlib.util
import pprint
import sys
import tempfile
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
from record import record

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
UNUSED = ("cv2", "torch", "torch.nn", "torch.nn.functional", "torch.distributed")


def module_of(path: Path) -> ModuleType:
    """Import a file of a clone."""
    spec = importlib.util.spec_from_file_location(f"public_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def as_tensor(values: np.ndarray) -> SimpleNamespace:
    """What DSINE's statistics ask of a tensor: detach().cpu().numpy()."""
    on_cpu = SimpleNamespace(numpy=lambda: values)
    return SimpleNamespace(detach=lambda: SimpleNamespace(cpu=lambda: on_cpu))


def main(stereo: Path, dsine: Path) -> None:
    from test_eval_against_public import PUBLIC, compared_vectors, in_their_units, normal_maps
    from test_eval_fabricated_run import fabricate_run, table

    from huesphere.eval.external_maps import find_external_maps
    from huesphere.eval.report import write_report
    from huesphere.eval.score import read_items

    for name in UNUSED:
        sys.modules.setdefault(name, MagicMock())
    angles, statistics = module_of(stereo / "psutil.py"), module_of(dsine / "utils" / "utils.py")
    with tempfile.TemporaryDirectory() as folder:
        run, others = Path(folder) / "run", Path(folder) / "others"
        fabricate_run(run, {"bump/linear": {}})
        theirs = {}
        for name, image in normal_maps().items():
            path = others / name / "bump/linear.npy"
            path.parent.mkdir(parents=True)
            np.save(path, image)
            estimate, truth = (v.astype(np.float64) for v in compared_vectors(image))
            # They take the dot product for the cosine: single precision leaves lengths off 1 by 1e-7.
            estimate, truth = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (estimate, truth))
            error = angles.evaluate_angular_error(truth, estimate)
            theirs[name] = {key: float(v) for key, v in statistics.compute_normal_metrics(as_tensor(error)).items()}
        write_report(run, estimates=find_external_maps(others, read_items(run)))
        rows = {row["method"]: row for row in table(run)}
    pprint.pprint(theirs, sort_dicts=False)
    worst = max(abs(in_their_units(rows[name], PUBLIC[key]) - theirs[name][key]) for name in theirs for key in PUBLIC)
    record("metric table against RobustPhotometricStereo and DSINE, 3 normal maps", worst, "deg or %", note="largest")


if __name__ == "__main__":
    main(*(Path(text) for text in sys.argv[1:3]))
