"""Named ways in which recovery fails, each with its remedy: failure is a value, never a number dressed as a result."""

REMEDIES = {
    "too-few-pixels": "give a larger picture or region: at least 50 usable pixels of the object are needed",
    "not-finite": "mend the picture: most pixels of the object are NaN or infinite",
    "saturated": "expose less: most pixels of the object are clipped",
    "rank-deficient-colours": "use lights of three colours or more, in directions that do not lie in one plane",
    "flat-surface": "choose a region where the surface turns: its colour hardly varies",
    "no-ellipsoid": "choose a region of one matte material: no ellipsoid about black fits the colours",
    "ellipsoid-undetermined": "choose a region whose normals spread in two directions: more than one ellipsoid fits",
    "no-dominant-shell": "take an object of one colour, lights within 40° of the axis: no ellipsoid holds most pixels",
    "extended-lights": "use smaller or fewer lights: neither single ones nor a smooth map of the normal explain all",
    "too-scattered": "choose a larger region: the accepted pixels do not hang together and have no derivatives",
    "no-silhouette": "give the object's mask, with background about it: the method needs the whole outline",
    "n3-signs": "check the lights and the region: the recovered normals face both toward and away from the camera",
    "rotation-undetermined": "choose a larger region or lessen the noise: many rotations fit",
    "singular": "choose another region: equations of the method have no one solution for these colours",
    "lights-not-told": "set recover.lights: told in the config of an orthographic picture that has near lights",
    "lights-unexplained": "check where the lights are told to be, and that surfaces hardly send each other light",
    "uncertain": "lessen the noise, or light with one primary colour a lamp, three lamps 120° apart about 40° off axis",
    "model-misfit": "use a matte object of one colour under far lamps, and linear samples without ambient light",
    "not-integrable": "check that the region is one surface of one colour: no surface has these normals",
    "facing-away": "check the lights and the region: normals of a visible surface face the camera",
    "convex-or-concave": "both are solutions: n1 and n2 of the other one have the opposite signs",
    "little-explained": "use fewer lights, closer to the camera's axis, so that more of the object sees all of them",
    "rig-misfit": "check that lights, camera and reference are those of the calibration, else calibrate again",
    "unconfirmed-hue": "check that the object is of one hue; other methods take its brightness as uniform",
    "no-convergence": "reduce noise or choose a larger region: the search for the rotation did not settle",
}


# Statuses that only the verdict gives: the method itself found nothing wrong, and its normals are compared.
DOUBTS = (
    "uncertain",
    "model-misfit",
    "not-integrable",
    "facing-away",
    "convex-or-concave",
    "little-explained",
    "unconfirmed-hue",
)


class RecoveryFailure(Exception):
    """Recovery cannot go on. ``status`` is a key of REMEDIES, ``found`` says in a few words what was measured."""

    def __init__(self, status: str, found: str) -> None:
        self.status = status
        self.message = f"{found}; {REMEDIES[status]}"
        super().__init__(f"{status}: {self.message}")
