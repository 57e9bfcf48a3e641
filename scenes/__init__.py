"""What the world is: spectra, shapes, lights and cameras, as plain arrays. Nothing here renders."""
