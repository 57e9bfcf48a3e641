"""The table of all kinds of cases: those of fuzz.py, of files, and of run folders."""

from fuzz import CASES as FIRST
from fuzz_files import any_picture_case, mask_case, no_file_case, normal_map_case, spectrum_case
from fuzz_run_folders import hostile_run_case

CASES = FIRST | {
    "any picture": any_picture_case,
    "mask": mask_case,
    "normal map": normal_map_case,
    "spectrum": spectrum_case,
    "no file": no_file_case,
    "hostile run folder": hostile_run_case,
}
