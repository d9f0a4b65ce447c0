"""Numbers of the paper that reports set beside ours, each with where it stands.

Singh, Benallegue, Morisawa, Cisneros, Kanehiro: Learning Bipedal Walking On Planned Footsteps For
Humanoid Robots, IEEE-RAS Humanoids 2022 (arXiv 2207.12644). Numbers that the paper has but that
nobody could look up here are left out, not guessed. Its limits on the joints of HRP-5P are in
`sim/robots/hrp5p.py`.
"""

from __future__ import annotations

TITLE = "Singh et al. 2022"

# Evaluation on stairs of 10 cm: the figures on terrain noise and on observation noise.
TREAD_NOISE_WITHSTOOD_M = 0.03
JOINT_NOISE_WITHSTOOD_DEG = 3.0

# The text on the step reward: a step counts as hit when either foot is this near.
HIT_RADIUS_M = 0.20
