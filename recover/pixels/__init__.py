"""Which pixels may take part, and how much of their colour is noise.

In order: ``usable`` chooses the pixels; ``noise`` says how noisy they are; ``rank`` tells how many dimensions the
colours of a patch span; ``uncertain_component`` weighs colours of which one direction is known less well.
"""
