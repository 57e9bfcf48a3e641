"""Methods that are given more than one picture: what each of them knows.

They are run by the evaluator from an item's layers and truth, never by `recover`, and every table marks them, so that
nobody takes them for methods that see one picture.
"""

REFERENCES = {"woodham1980": "lights known, a picture under each"}
