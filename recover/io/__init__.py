"""A picture, mask or estimate on disk, and the page about it.

In the order in which a picture file is read: ``files`` chooses the reader by the file's ending (``raster``, ``tiff``,
``exr_picture``, ``numpy_file``, ``camera_raw``, ``heif``), which gives a ``stored`` record; ``decoding`` makes linear
light of it, by ``transfer``, ``icc`` and ``levels``; ``frames`` corrects it by dark and flat frames; ``orientation``
turns it upright; ``mask`` says where the object is; ``picture`` does all this. ``estimate`` is the record of what a
method found, with its reader and writer; ``page`` draws the HTML page of a picture.
"""
