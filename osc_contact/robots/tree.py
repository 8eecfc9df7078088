"""Links and joints must form one tree, and mimic joints must follow joints that exist."""

from __future__ import annotations

from osc_contact.robots.document import Document, Joint
from osc_contact.robots.findings import suggest

__all__ = ["check_tree", "check_mimics"]


def check_tree(document: Document) -> None:
    """Note unknown ends, links with two parents, several roots and loops."""
    links, above = document.links, dict[str, Joint]()
    for joint in document.joints.values():
        for word, name in (("parent", joint.parent), ("child", joint.child)):
            element = joint.element.find(word)
            if element is not None and name not in links:
                document.add("tree", element, f"the {word} link {name!r} does not exist",
                             suggest(name, list(links)[:40]), "link")  # fmt: skip
        if joint.parent == joint.child:
            document.add("tree", joint.element, f"joins the link {joint.child!r} to itself",
                         "a joint needs two links")  # fmt: skip
        elif joint.child in above:
            document.add("tree", joint.element, f"the link {joint.child!r} already hangs on joint "
                         f"{above[joint.child].name!r}", "close loops as contacts or constraints, "
                         "not in the URDF")  # fmt: skip
        above[joint.child] = joint
    if document.findings:
        return
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        document.add("tree", links[roots[1]].element, f"{len(roots)} links have no parent: "
                     f"{', '.join(map(repr, roots[:5]))}; a robot has one root",
                     "join them or delete the loose ones")  # fmt: skip
    _check_loops(document, above)


def check_mimics(document: Document) -> None:
    """Note mimic joints that follow nothing, themselves or each other."""
    joints = document.joints
    for joint in joints.values():
        element = joint.element.find("mimic")
        if joint.mimic is None or element is None:
            continue
        if joint.mimic not in joints:
            document.add("joint", element, f"follows the joint {joint.mimic!r}, which does not "
                         "exist", suggest(joint.mimic, list(joints)[:40]), "joint")  # fmt: skip
            continue
        if joints[joint.mimic].kind == "fixed":
            document.add("joint", element, f"follows the fixed joint {joint.mimic!r}",
                         "follow a joint that moves", "joint")  # fmt: skip
        seen, follower = {joint.name}, joint
        while follower.mimic is not None and follower.mimic in joints:
            follower = joints[follower.mimic]
            if follower.name in seen:
                if follower is joint:
                    document.add("joint", element, "follows itself", "follow another", "joint")
                break
            seen.add(follower.name)


def _check_loops(document: Document, above: dict[str, Joint]) -> None:
    """Links whose way upwards never ends lie on a loop or hang on one."""
    grounded: set[str] = set()
    for name in document.links:
        way: list[str] = []
        while name in above and name not in grounded and name not in way:
            way.append(name)
            name = above[name].parent
        if name in way:
            loop = way[way.index(name) :]
            document.add("tree", above[name].element, f"the links {' → '.join(map(repr, loop[:5]))}"
                         " form a loop", "open it; close loops as constraints")  # fmt: skip
            return
        grounded.update(way)
