"""Cues to the rotation and to the convex/concave ambiguity that need neither lights nor a depth map.

``linear_integrability`` measures how integrable normals are under every rotation, in a form that is linear in it;
``silhouette`` reads the rotation off the object's silhouette; ``convexity`` chooses between the convex and the concave
solution. Tuned numbers: ``parameters``.
"""
