"""Study `report_1994`: the statements of the report one by one, what is measured of each, and whether it holds."""

from collections.abc import Sequence
from pathlib import Path

from huesphere.configs.load import load_config
from huesphere.configs.study import Report1994
from huesphere.eval.studies.attitude_claims import attitude_section
from huesphere.eval.studies.light_claims import mutual_illumination_section, regression_section
from huesphere.eval.studies.page import Section, Study
from huesphere.eval.studies.photograph import photograph_section
from huesphere.eval.studies.pictures import Log, Rendered, read, render, text
from huesphere.eval.studies.synthetic_claims import recovered, synthetic_section


def report_1994(study: Report1994, folder: Path, log: Log, jobs: int) -> Study:
    """Render the pictures into ``folder``/run, recover them, and test all claims.

    ``jobs`` is ignored: one process takes only minutes.
    """
    run = folder / "run"
    bust = _linear_picture(study, None, run, log)
    natural = bust.layers.colours[:, 0, 0]
    log("recovering the synthetic picture")
    on_bust = recovered("bust", bust)
    sections = [synthetic_section(on_bust)]
    if study.scan is not None:
        sections.append(synthetic_section(recovered("scan", _linear_picture(study, study.scan, run, log))))
    log("the closed form on known surfaces")
    sections.append(attitude_section(study.trials))
    log("the regression")
    sections.append(regression_section(study, natural, bust))
    log("mutual illumination")
    sections.append(mutual_illumination_section(study, run, log))
    log("photographs")
    sections.append(photograph_section(study.photograph, bust, natural[3]))
    return Study(
        "report_1994",
        "Drew & Kontsevich (1994), claim by claim",
        _answer(sections, on_bust.error_deg("drew-kontsevich"), on_bust.error_deg("weak-integrability")),
        tuple(sections),
        (),
    )


def _linear_picture(study: Report1994, shape: str | None, run: Path, log: Log) -> Rendered:
    """The picture, transport `linear`, of the study's scene, with its own shape or with the file ``shape``."""
    side = study.resolution
    overrides = [f"camera.resolution=[{side}, {side}]", "render.transport=[linear]"]
    config = load_config(study.scene, overrides=overrides, shape=shape)
    if shape is not None:
        config = config.model_copy(update={"name": f"{config.name}_scan"})
    render([config], run, log)
    return read(run, f"{config.name}/linear")


def _answer(sections: Sequence[Section], closed_deg: float, weak_deg: float) -> tuple[str, ...]:
    """The answer of the study: how many claims hold, and which do not."""
    claims = [claim for section in sections for claim in section.claims]
    failed = {c.says: c.place for c in claims if c.verdict in ("does not hold", "does not follow")}
    listed = "; ".join(f"“{says.rstrip('.')}” ({place})" for says, place in failed.items())
    return (
        (
            f"Of {len(claims)} statements of the report {sum(c.verdict == 'holds' for c in claims)} hold as they "
            f"stand. The method works as described: {text(closed_deg)}° median on its synthetic picture, where the "
            f"report has 15.6°; with the rotation taken from integrability in weak form {text(weak_deg)}°."
        ),
        f"What does not hold, or does not follow: {listed}." if listed else "Nothing in it was found wrong.",
    )
