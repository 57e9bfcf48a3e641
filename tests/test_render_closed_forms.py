"""Light between surfaces against closed forms of radiometry and heat transfer.

Tolerances are the 99.9 % confidence interval over independent seeds, plus a stated term for the mesh where it is not
the shape itself. A cosine left out or a factor of 2 is an error of tens of per cent in every one of them.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from huesphere.configs.load import load_config
from huesphere.render.bounces import BounceRequest, Bounces
from huesphere.render.gather import apply_operator
from huesphere.render.layers import PARTS
from huesphere.render.picture import assemble
from huesphere.render.raycast import ray_caster
from huesphere.render.transport import trace
from huesphere.scenes import primitives
from huesphere.scenes.build import build_scene
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.quadrature import fibonacci_lattice
from huesphere.scenes.room import WALLS

X, Y, Z = np.eye(3)
SEEDS = range(8)


def make(*overrides):
    return build_scene(load_config("sphere_quick", overrides=["camera.resolution=[32,32]", *overrides]))


def run(mi, scene, *, target, reach="full"):
    return trace(scene, mi, reach=reach, target_rms=target, max_bounces=None, seed=0, progress=lambda *_: None)


def gather(caster, points, values, rays, seed):
    """K applied to ``values`` (V, C) at the mesh's vertices, at ``points``; (n, C)."""
    shift = np.random.default_rng(seed).random((len(points.uv), 2), dtype=np.float32)
    hits = caster.hemisphere_hits(points, slice(0, len(points.uv)), fibonacci_lattice(rays), shift)[0]
    return apply_operator(hits, caster.mesh, np.ones((1, values.shape[1])), values, rays)


def on_first_rectangle(caster, square):
    """Points at ``square`` (n, 2) in [0, 1]² of a rectangle of one cell, whose two triangles come first in the mesh."""
    u, v = square.T
    first = u >= v
    return caster.points_on(
        np.where(first, 0, 1), np.where(first[:, None], np.stack([u - v, v], 1), np.stack([u, v - u], 1))
    )


def mean_and_error(estimates):
    """Mean over independent estimates, and the half width of its 99.9 % confidence interval."""
    values = np.array(estimates, dtype=float)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return values.mean(axis=0), stats.t.ppf(1 - 0.5e-3, len(values) - 1) * error


def polygon_factor(position, normal, corners):
    """Share of the light of each point's hemisphere that comes from a polygon of radiance 1; (n,).

    Lambert's formula (Photometria, 1760): F = (1/2π) Σ θ_j n·Γ_j, θ_j the angle that edge j subtends, Γ_j the unit
    normal of the plane through it and the point; the polygon cut at the horizon first.
    """
    out = np.zeros(len(position))
    for i, (p, n) in enumerate(zip(position.astype(float), normal.astype(float), strict=True)):
        seen = []
        for a, b in zip(corners - p, np.roll(corners, -1, axis=0) - p, strict=True):
            above_a, above_b = a @ n, b @ n
            if above_a >= 0:
                seen.append(a)
            if above_a * above_b < 0:
                seen.append(a + (b - a) * above_a / (above_a - above_b))
        for a, b in zip(seen, seen[1:] + seen[:1], strict=True):
            cross = np.cross(a, b)
            size = np.linalg.norm(cross)
            out[i] += np.arctan2(size, a @ b) * (cross @ n) / max(size, 1e-300)
    return np.abs(out) / (2 * np.pi)


# ---- rectangles ----------------------------------------------------------------------------------------------------


def parallel_rectangles(a, b, c):
    """From one a × b rectangle to its like at distance c (Howell, catalogue of configuration factors, C-11)."""
    x, y = a / c, b / c
    edges = x * np.hypot(1, y) * np.arctan(x / np.hypot(1, y)) + y * np.hypot(1, x) * np.arctan(y / np.hypot(1, x))
    logarithm = 0.5 * np.log((1 + x**2) * (1 + y**2) / (1 + x**2 + y**2))
    return 2 / (np.pi * x * y) * (logarithm + edges - x * np.arctan(x) - y * np.arctan(y))


def perpendicular_rectangles(w, h, l):
    """From a w × l rectangle to one h × l that stands on its edge l (Howell, C-14)."""
    W, H = w / l, h / l
    W2, H2, both = W**2, H**2, 1 + W**2 + H**2
    angles = W * np.arctan(1 / W) + H * np.arctan(1 / H) - np.hypot(W, H) * np.arctan(1 / np.hypot(W, H))
    logarithms = (
        np.log((1 + W2) * (1 + H2) / both)
        + W2 * np.log(W2 * both / ((1 + W2) * (W2 + H2)))
        + H2 * np.log(H2 * both / ((1 + H2) * (H2 + W2)))
    )
    return (angles + logarithms / 4) / (np.pi * W)


def rectangle_to_rectangle(mi, emitter, receiver):
    """Share of the light of ``emitter`` in the hemispheres of ``receiver``, averaged over it; and how sure that is."""
    mesh = primitives.join([receiver, emitter])
    caster = ray_caster(mi, mesh, offset=1e-5)
    light = np.repeat([0.0, 1.0], [len(receiver.vertices), len(emitter.vertices)])[:, None]
    estimates = []
    for seed in SEEDS:
        square = (fibonacci_lattice(1024) + np.random.default_rng((seed, 1)).random(2)) % 1
        estimates.append(gather(caster, on_first_rectangle(caster, square), light, 256, seed).mean())
    return mean_and_error(estimates)


def test_the_closed_forms_of_rectangles_fill_a_box():
    a, b, c = 1.0, 2.0, 0.7
    walls = 2 * perpendicular_rectangles(a, c, b) + 2 * perpendicular_rectangles(b, c, a)
    assert parallel_rectangles(a, b, c) + walls == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(("a", "b", "c"), [(1, 1, 1), (1, 2, 0.5), (3, 1, 0.2), (1, 1, 4)])
def test_parallel_rectangles_see_each_other_as_the_catalogue_says(mi, a, b, c):
    # Goral, Torrance, Greenberg & Battaile (1984) held the first radiosity pictures against such form factors.
    floor = primitives.rectangle(np.zeros(3), a * X, b * Y, (1, 1))
    ceiling = primitives.rectangle(c * Z, b * Y, a * X, (1, 1))
    value, error = rectangle_to_rectangle(mi, ceiling, floor)
    assert error < 6e-4
    assert value == pytest.approx(parallel_rectangles(a, b, c), abs=error + 2e-5)  # 2e-5: rays start 1e-5 off


@pytest.mark.parametrize(("w", "h", "l"), [(1, 1, 1), (0.5, 2, 1), (1, 0.3, 2), (3, 1, 1)])
def test_perpendicular_rectangles_see_each_other_as_the_catalogue_says(mi, w, h, l):
    floor = primitives.rectangle(np.zeros(3), w * X, l * Y, (1, 1))
    wall = primitives.rectangle(np.zeros(3), l * Y, h * Z, (1, 1))
    value, error = rectangle_to_rectangle(mi, wall, floor)
    assert error < 6e-4
    assert value == pytest.approx(perpendicular_rectangles(w, h, l), abs=error + 2e-5)


# ---- grooves -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [40, 90, 140])
def test_walls_of_a_long_groove_see_each_other_by_crossed_strings(mi, angle):
    # In two dimensions a strip fills (sin φ2 − sin φ1) / 2 of a hemisphere, φ from the normal: at x on a wall, the
    # other wall, of length 1 from the vertex on, fills (1 + (cos ψ − x) / √(1 + x² − 2x cos ψ)) / 2. The mean over the
    # wall is 1 − sin(ψ/2), Hottel's crossed strings (Hottel & Sarofim, Radiative Transfer, 1967). Ends are 500 away.
    psi, long = np.radians(angle), 1000.0
    along = np.array([np.cos(psi), 0.0, np.sin(psi)])
    walls = [
        primitives.rectangle(-long / 2 * Y, X, long * Y, (1, 1)),
        primitives.rectangle(-long / 2 * Y, long * Y, along, (1, 1)),
    ]
    caster = ray_caster(mi, primitives.join(walls), offset=1e-6)
    x = (np.arange(64) + 0.5) / 64
    points = on_first_rectangle(caster, np.stack([x, np.full(64, 0.5)], axis=1))
    light = np.repeat([0.0, 1.0], 4)[:, None]
    estimates = [gather(caster, points, light, 4096, seed)[:, 0] for seed in SEEDS]
    expected = (1 + (np.cos(psi) - x) / np.sqrt(1 + x**2 - 2 * x * np.cos(psi))) / 2
    noise = np.sqrt(np.mean(np.var(estimates, axis=0, ddof=1)) / len(SEEDS))
    assert noise < 5e-4
    assert np.sqrt(np.mean((np.mean(estimates, axis=0) - expected) ** 2)) < 1.5 * noise
    value, error = mean_and_error(np.mean(estimates, axis=1))
    assert value == pytest.approx(1 - np.sin(psi / 2), abs=error + 2e-5)  # 2e-5: midpoint rule in x


@pytest.mark.parametrize("angle", [50, 90, 130])
@pytest.mark.parametrize("target", [1e-2, 2e-3])
def test_pixels_of_a_groove_have_lamberts_polygon_and_the_error_that_is_claimed(mi, angle, target):
    # One bounce in a finite groove of plane walls: each wall is evenly lit, and seen from the other as one rectangle.
    # The mesh is the shape itself, so all the error there is must be the standard error that the renderer claims.
    scene = make(
        f"shape={{kind: v_groove, angle: {angle}, detail: 4}}",
        "lights=[{direction: [0,0,1], spectrum: E}, {kind: ambient, spectrum: E, intensity: 1}]",
        "surface.reflectance=1.0",
    )
    traced = run(mi, scene, target=target, reach="one-bounce")
    position, normal = traced.pixels.points.position, traced.pixels.points.normal
    half = len(scene.mesh.vertices) // 2
    grids = scene.mesh.vertices.reshape(2, half, 3).reshape(2, 5, 9, 3)
    factor = np.zeros(len(position))
    for wall in (0, 1):
        here = np.abs(normal @ scene.mesh.normals[wall * half] - 1) < 1e-4
        other = grids[1 - wall][[0, -1, -1, 0], [0, 0, -1, -1]]
        factor[here] = polygon_factor(position[here], normal[here], other)
    for light, arrives in enumerate((np.sin(np.radians(angle / 2)), 1.0)):
        bounced = traced.images.mean(axis=0)[light, 1]
        relative = (bounced - arrives * factor) / (arrives + bounced.mean())  # of all light, at albedo 1
        assert np.sqrt(np.mean(relative**2)) == pytest.approx(traced.error, rel=0.15)
        assert abs(relative.mean()) < 0.25 * target  # 900 pixels with errors of their own


# ---- closed enclosures ---------------------------------------------------------------------------------------------


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), -mesh.normals, mesh.material)


def seen_from_inside(scene, mesh):
    """``scene`` with the closed ``mesh`` about the origin, the camera's rays starting inside it."""
    return replace(scene, mesh=inside_out(mesh), view=replace(scene.view, front=0.0))


INSIDE = (
    "lights=[{kind: ambient, spectrum: E, intensity: 1}, {kind: point, position: [0,0,0], spectrum: E},"
    " {kind: point, position: [0.4,0.1,0.2], spectrum: E}]"
)


@pytest.mark.parametrize("albedo", [0.3, 0.8, 0.95])
def test_an_integrating_sphere_multiplies_light_by_its_closed_form(mi, albedo):
    """Every point of a sphere sees every other alike: after one reflection light is even, whatever it was before.

    A source of flux Φ gives T_1 = T_2 = … = Φ / 4πR², and all indirect light together is that times a / (1 − a), the
    sphere multiplier (Goebel, Generalized integrating-sphere theory, Applied Optics 6, 125, 1967). The point sources
    have Φ = 4π, wherever they stand.
    """
    target, detail = 1e-2, 32
    scene = seen_from_inside(make(INSIDE, f"surface.reflectance={albedo}"), primitives.ball(detail))
    traced = run(mi, scene, target=target)
    images = traced.images.mean(axis=0).astype(float)  # (L, orders, n)
    sagitta = 1 - np.cos(np.pi / 4 / detail)  # so far the mesh is inside the sphere
    for light, mesh_error in enumerate((0.0, 4 * sagitta, 4 * sagitta)):
        orders = images[light, 1:].mean(axis=1)
        noise = 3 * target / albedo / (1 - albedo) / np.sqrt(images.shape[2]) if light else 1e-6
        assert np.abs(orders - 1).max() < mesh_error + noise
        indirect = np.sum(orders * albedo ** np.arange(1, len(orders) + 1))
        tail = 0.02 * target / (1 - albedo)  # the series ends where an order is so weak
        assert indirect == pytest.approx(albedo / (1 - albedo), rel=mesh_error + noise + tail)
    full, direct = (assemble(scene, traced, t).layers for t in ("full", "direct"))
    seen = traced.mask()
    ratio = sum(full.rgb(0, part)[seen] for part in PARTS) / direct.rgb(0, "direct")[seen]
    assert np.abs(ratio * (1 - albedo) - 1).max() < tail + 1e-5


def cavity(detail):
    """The inside of a dented ball: irregular, closed, and hiding parts of itself."""
    ball = primitives.ball(detail)
    d = ball.vertices
    radius = 1 + 0.25 * np.sin(3 * d[:, 0] + 1) * np.cos(2 * d[:, 1])
    radius -= 0.35 * np.exp(-8 * np.sum((d - [0.8, 0.6, 0.0]) ** 2, axis=1))
    vertices = d * radius[:, None]
    corner = vertices[ball.faces]
    facet = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros_like(vertices)
    np.add.at(normals, ball.faces.ravel(), np.repeat(facet, 3, axis=0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return inside_out(Mesh(vertices, ball.faces, normals, ball.material)), np.linalg.norm(facet, axis=1) / 2


def at_facets(mi, mesh):
    caster = ray_caster(mi, mesh, offset=1e-4)
    return caster, caster.points_on(np.arange(len(mesh.faces)), np.full((len(mesh.faces), 2), 1 / 3))


def test_no_light_is_lost_or_made_in_a_closed_cavity(mi):
    # At albedo 1 all that a source sends, 4π in our unit, arrives at every order: ∫ T_k dA = 4π for every k, whatever
    # the cavity's shape. Under light that is 1 everywhere every row must sum to 1.
    mesh, area = cavity(32)
    lights = "lights=[{kind: point, position: [-0.3,0.1,0.2], spectrum: E}, {kind: ambient, spectrum: E, intensity: 1}]"
    scene = replace(make(lights, "surface.reflectance=1.0"), mesh=mesh)
    caster, points = at_facets(mi, mesh)
    bounces = Bounces(scene, caster, 5, 0.0, rest=True)
    orders = [bounces.all_bounces(BounceRequest(points, np.zeros(0), 32, (seed,)))[1] @ area for seed in SEEDS]
    value, error = mean_and_error(np.array(orders)[:, 0] / (4 * np.pi))
    assert error.max() < 5e-3
    assert np.abs(value - 1).max() < error.max() + 2.5e-3  # mesh: 1.8e-3 of the direct light here, falls with h²
    even = np.array(orders)[:, 1] / area.sum()
    assert even.max() < 1 + 1e-6
    assert even.min() > 1 - 1e-5  # a ray in 10⁵ slips out between smooth normals and flat facets


def test_light_takes_both_ways_alike_by_rays(mi):
    # Helmholtz reciprocity, A_i F_ij = A_j F_ji, for two patches of a cavity that see each other in part.
    mesh, area = cavity(48)
    caster, points = at_facets(mi, mesh)
    patches = np.stack(
        [np.exp(-6 * np.sum((mesh.vertices - at) ** 2, axis=1)) for at in ([0.7, 0.0, 0.3], [-0.4, 0.8, -0.1])], axis=1
    )
    here = patches[mesh.faces].mean(axis=1)
    ways = []
    for seed in SEEDS:
        gathered = gather(caster, points, patches, 16, seed)
        ways.append([(area * here[:, 0]) @ gathered[:, 1], (area * here[:, 1]) @ gathered[:, 0]])
    (there, back), error = mean_and_error(ways)
    assert there == pytest.approx(back, abs=np.hypot(*error) + 2e-3 * back)  # 1.1e-3 by the mesh, falls with h²
    assert there > 0.1 * np.sqrt((area @ here).prod()) / area.sum()  # no trivial zero


def test_a_room_and_what_stands_in_it_are_a_furnace(mi):
    """In a closed room of one albedo a under even light 1, all light together is 1 / (1 − a) everywhere.

    The furnace test, for the sum over walls with its correction where the object stands in the way.
    """
    albedo = 0.7
    walls = ", ".join(f"{wall}: {albedo}" for wall in WALLS)
    scene = make(
        f"room={{{walls}, width: 4, height: 4, behind: 1, before: 2, detail: 12}}",
        "lights=[{kind: ambient, spectrum: E, intensity: 1}]",
        f"surface.reflectance={albedo}",
    )
    dented, _ = cavity(32)
    scene = replace(scene, mesh=inside_out(dented))
    traced = run(mi, scene, target=5e-3)
    full, direct = (assemble(scene, traced, t).colour[traced.mask()].sum(axis=1) for t in ("full", "direct"))
    assert np.abs(full / direct * (1 - albedo) - 1).max() < 1e-3


def test_walls_of_a_room_are_lamberts_polygons(mi):
    # What comes by one bounce off each wall is a component of its own: the wall's rectangle, evenly lit, cut at the
    # pixel's horizon. A ball hides nothing from itself.
    walls = ", ".join(f"{wall}: 1.0" for wall in WALLS)
    scene = make(
        "shape={kind: sphere, detail: 64}",
        f"room={{{walls}, width: 4, height: 5, behind: 1, before: 2, detail: 16}}",
        "lights=[{kind: ambient, spectrum: E, intensity: 1}]",
        "surface.reflectance=1.0",
    )
    traced = run(mi, scene, target=5e-3, reach="one-bounce")
    position, normal = traced.pixels.points.position, traced.pixels.points.normal
    for number, (corner, u, v) in enumerate(scene.enclosure.rectangles()):
        expected = polygon_factor(position, normal, np.array([corner, corner + u, corner + u + v, corner + v]))
        component = traced.components.names.index(f"one_bounce.{scene.enclosure.first_material + number}")
        bounced = traced.images.mean(axis=0)[0, component]
        assert expected.max() > 0.03  # the back wall is seen only past the ball's edge
        assert np.abs(bounced - expected).max() < 2e-3, WALLS[number]  # the horizon cuts the quadrature on the wall


# ---- rates ---------------------------------------------------------------------------------------------------------


def order_of_convergence(details, errors):
    """p of error ∝ detail^−p."""
    return -np.polyfit(np.log(details), np.log(np.abs(errors)), 1)[0]


def test_a_ball_over_a_floor_tends_to_its_closed_form_with_the_square_of_the_mesh(mi):
    # A ball above the horizon fills cosθ (R/d)² of a hemisphere (Nusselt's analogue, 1928): facets cut it short.
    details, height = np.array([4, 8, 16, 32]), 1.6
    errors = []
    for detail in details:
        floor = primitives.rectangle(np.array([-9.0, -9.0, -height]), 18 * X, 18 * Y, (1, 1))
        ball = primitives.ball(detail)
        caster = ray_caster(mi, primitives.join([floor, ball]), offset=1e-5)
        points = on_first_rectangle(caster, 0.45 + 0.1 * np.random.default_rng(0).random((64, 2)))
        light = np.repeat([0.0, 1.0], [4, len(ball.vertices)])[:, None]
        expected = height / np.linalg.norm(points.position, axis=1) ** 3
        gathered = [gather(caster, points, light, 1 << 13, seed)[:, 0] for seed in SEEDS]
        errors.append(np.mean(np.array(gathered) / expected - 1))
    assert order_of_convergence(details, errors) == pytest.approx(2, abs=0.1)
    assert -1.1e-3 < errors[-1] < 0  # measured −8.1e-4


def test_a_bowl_tends_to_its_closed_form_with_the_square_of_the_mesh(mi):
    # A half sphere under light along its axis: T_1 = 1/4 everywhere (an integrating sphere, see test_render_transport).
    details = np.array([8, 16, 32, 64])
    errors = []
    for detail in details:
        scene = make(
            f"shape={{kind: bowl, opening: 90, detail: {detail}}}",
            "lights=[{direction: [0,0,1], spectrum: E}]",
        )
        caster = ray_caster(mi, scene.mesh, offset=1e-5)
        face = np.random.default_rng(0).permutation(len(scene.mesh.faces))[:256]
        points = caster.points_on(face, np.full((len(face), 2), 1 / 3))
        bounces = Bounces(scene, caster, 1, 0.0, rest=False)
        first = bounces.all_bounces(BounceRequest(points.take(points.normal[:, 2] > 0.3), np.zeros(0), 4096, (0,)))[1]
        errors.append(first[0, 0].mean() / 0.25 - 1)
    assert order_of_convergence(details, errors) == pytest.approx(2, abs=0.25)
    assert abs(errors[-1]) < 2e-4  # measured −7.6e-5


# ---- light adds up -------------------------------------------------------------------------------------------------


def test_two_lights_together_are_each_alone(mi):
    lights = ["{direction: [0.3,0.2,1], spectrum: FL2}", "{kind: point, position: [0.2,0.3,1.0], spectrum: A}"]
    shape = "shape={kind: bowl, opening: 75, detail: 32}"
    pictures, errors = [], []
    for chosen in (lights, lights[:1], lights[1:]):
        scene = make(shape, f"lights=[{', '.join(chosen)}]", "surface.reflectance=0.8")
        traced = run(mi, scene, target=4e-3)
        pictures.append({t: assemble(scene, traced, t).colour[traced.mask()] for t in ("linear", "direct", "full")})
        errors.append(traced.error)
    for transport in ("linear", "direct"):
        together, first, second = (picture[transport] for picture in pictures)
        assert np.abs(together - first - second).max() < 1e-6 * together.max()
    together, first, second = (picture["full"] for picture in pictures)
    relative = (together - first - second) / together.mean(axis=0)
    assert np.sqrt(np.mean(relative**2)) < 1.5 * np.sqrt(np.sum(np.square(errors)))
