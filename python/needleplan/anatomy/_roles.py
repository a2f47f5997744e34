"""Roles of structures by their names. The names are those of TotalSegmentator's classes, and words that labs use.

Source of the class names: `map_to_binary.py` of TotalSegmentator, tasks `total`, `body`, `lung_vessels`,
`liver_vessels` and `tissue_types` (https://github.com/wasserth/TotalSegmentator). An unknown name is an obstacle:
that is the safe side.
"""

from __future__ import annotations

import re
from enum import StrEnum

__all__ = ["StructureRole", "role_by_name"]


class StructureRole(StrEnum):
    """Role of a structure in a plan."""

    TARGET = "target"
    """What the tip must reach."""

    ENTRY = "entry"
    """Where the needle may enter."""

    OBSTACLE = "obstacle"
    """What the needle must not touch."""

    ORGAN = "organ"
    """Tissue if it holds the target, else an obstacle."""

    TISSUE = "tissue"
    """What the needle may pass."""

    BODY = "body"
    """The whole body: what is not in it is outside."""

    IGNORED = "ignored"
    """Left out."""


# Role, pattern in the name, and what the names have in common; the first that matches holds.
_ROLES = (
    (StructureRole.TARGET, r"tumou?r|lesion|target|nodule|metasta|\bgtv", "a target by its name"),
    (StructureRole.ENTRY, r"\bentry", "an entry region by its name"),
    (StructureRole.BODY, r"^((whole|patient) )?(body|torso|skin)\b(?! (fat|of)\b)", "the body by its name"),
    (StructureRole.OBSTACLE, r"arter|vein|aorta|vena|vessel|trunk|atri(um|al)|heart|ventricle|pulmonary|carotid",
     "a vessel or part of the heart"),
    (StructureRole.OBSTACLE, r"vertebra|\bribs?\b|sternum|sacrum|\bhip\b|femur|humerus|scapula|clavicula|skull|bone|"
     r"cartilage|mandible|tibia|fibula|patella|radius|ulna", "bone or cartilage"),
    (StructureRole.OBSTACLE, r"nerve|spinal|chiasm|brainstem|urethra", "a nerve or duct"),
    (StructureRole.OBSTACLE, r"stomach|duodenum|bowel|colon|rectum|esophagus|oesophagus|trachea|bronch|bladder|airway",
     "a hollow organ"),
    (StructureRole.ORGAN, r"liver|spleen|kidney|pancreas|adrenal|\blung|prostate|brain|thyroid|uterus|breast",
     "an organ"),
    (StructureRole.TISSUE, r"gluteus|autochthon|iliopsoas|muscle|\bfat\b|subcutaneous|tissue", "muscle or fat"),
)  # fmt: skip


def role_by_name(name: str) -> tuple[StructureRole, str]:
    """Return the role of a structure and the reason for it.

    Parameters
    ----------
    name : str
        Name of the structure, as `portal_vein_and_splenic_vein` of TotalSegmentator.

    Returns
    -------
    tuple of StructureRole and str

    Examples
    --------
    >>> from needleplan.anatomy import role_by_name
    >>> role, reason = role_by_name("portal_vein_and_splenic_vein")
    >>> print(role, "-", reason)
    obstacle - a vessel or part of the heart
    """
    words = re.sub(r"[\W_]+", " ", name.lower())
    matches = ((role, reason) for role, pattern, reason in _ROLES if re.search(pattern, words))
    return next(matches, (StructureRole.OBSTACLE, "an unknown name"))
