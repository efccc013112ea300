"""A chain of three links as URDF and MJCF text, to be coupled and damaged."""

LIMIT = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'


def link(name, mass, x=0.2, moments=(0.01, 0.02, 0.02), shape=""):
    xx, yy, zz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia'
        f' ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
    )


def joint(name, parent, child, x=0.4, axis="0 1 0", kind="revolute", limit=LIMIT, extra=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="{axis}"/>{limit}{extra}</joint>'
    )


CHAIN = (
    '<link name="base"/>',
    link("l1", 2.0),
    link("l2", 1.5),
    link("l3", 1.0),
    joint("j1", "base", "l1", axis="0 0 1"),
    joint("j2", "l1", "l2"),
    joint("j3", "l2", "l3"),
    '<link name="tool"/>',
    joint("flange", "l3", "tool", 0.3, kind="fixed"),
)
BALANCED = (
    *CHAIN,
    link("counterweight", 20.0, -0.5, (0.1, 0.3, 0.3)),
    joint("k_balance", "l1", "counterweight", 0.0, extra='<mimic joint="j2" multiplier="-1"/>'),
)


def robot(parts):
    """URDF text of links and joints."""
    return f'<robot name="a">{"".join(parts)}</robot>'


def mimic(leader, ratio=1.0, offset=0.0):
    return f'<mimic joint="{leader}" multiplier="{ratio}" offset="{offset}"/>'


def three_links(extra="", beside=""):
    """MJCF text with elements after the bodies, and within the first link's."""
    body = '<inertial pos="0.2 0 0" mass="1.5" diaginertia="0.01 0.02 0.02"/>'
    hinge = '<joint name="j{}" axis="0 {} {}" range="-2 2"/>'
    return (
        '<mujoco><compiler angle="radian"/><worldbody><body name="base"><body name="l1">'
        f'{hinge.format(1, 0, 1)}{body}{beside}<body name="l2" pos="0.4 0 0">'
        f'{hinge.format(2, 1, 0)}{body}<body name="l3" pos="0.4 0 0">'
        f'{hinge.format(3, 1, 0)}{body}<site name="tcp" pos="0.3 0 0"/>'
        f"</body></body></body></body></worldbody>{extra}</mujoco>"
    )
