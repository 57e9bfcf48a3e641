"""The comparison of a picture with that of Mitsuba's own path tracer, for several test files."""

import numpy as np
import pytest
from scipy import ndimage, stats

from huesphere.render.picture import assemble
from huesphere.render.reference import render_reference
from huesphere.render.transport import trace


def require_equal_to_stock(mi, scene, transport, *, samples=128, target=2e-3, margin=3):
    """Fail unless each pixel of ``scene`` is that of the stock path tracer within its noise, and so is the mean.

    The stock picture comes in 16 independent batches of ``samples`` a pixel, whose spread is its noise; each pixel's
    difference is a t statistic, and the worst of them is held against all that are tested.
    """
    traced = trace(scene, mi, reach=transport, target_rms=target, max_bounces=None, seed=0, progress=lambda *_: None)
    ours = assemble(scene, traced, transport, mi).colour
    batches = np.stack(
        [render_reference(mi, scene, transport, samples=samples, seed=s, max_bounces=None) for s in range(16)]
    )
    # A pixel is of one material, that of its centre: where two meet the stock picture mixes them.
    material = traced.image(traced.pixels.material.astype(float), fill=-1)
    inside = ndimage.binary_erosion(traced.mask(), iterations=margin)
    inside &= ndimage.maximum_filter(material, 3) == ndimage.minimum_filter(material, 3)
    error = np.hypot(batches.std(axis=0, ddof=1) / 4, target * ours[inside].mean(axis=0))
    t = ((ours - batches.mean(axis=0)) / error)[inside]
    p = 2 * stats.t.sf(np.abs(t), df=len(batches) - 1)
    assert p.min() * p.size > 1e-3, f"worst pixel p = {p.min():.1e} of {p.size}"
    assert ours[inside].mean(axis=0) == pytest.approx(batches.mean(axis=0)[inside].mean(axis=0), rel=5e-3)
