"""Small URDF files, written from their joints and links."""


def link(name, mass=1.0, inertia=0.01, centre="0 0 0.2"):
    """A link with the same inertia about its three axes."""
    numbers = " ".join(f'i{a}="{inertia if a[0] == a[1] else 0}"' for a in ("xx", "xy", "xz", "yy", "yz", "zz"))
    origin = f'<origin xyz="{centre}"/>'
    return f'<link name="{name}"><inertial>{origin}<mass value="{mass}"/><inertia {numbers}/></inertial></link>'


def joint(name, parent, child, kind="revolute", axis="0 1 0", limit='effort="10" lower="-2" upper="2"', more=""):
    """A joint 0.4 m above the one before."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.4"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<limit velocity="3" {limit}/>{more}</joint>'


def write(folder, *parts, base='<link name="base"/>'):
    """The path of a file with these parts."""
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{base}{"".join(parts)}</robot>')
    return path


def motor(name):
    """The transmission of a joint."""
    parts = f'<type>SimpleTransmission</type><joint name="{name}"/><actuator name="m"/>'
    return f'<transmission name="t">{parts}</transmission>'


CART = (
    link("cart"),
    link("pole", 0.1),
    joint("slide", "base", "cart", "prismatic", "1 0 0", 'effort="20" lower="-2" upper="2"'),
    joint("pivot", "cart", "pole", "continuous", limit='effort="0"'),
)
LIFT = (
    link("low_stage", 5.0),
    link("top_stage", 3.0),
    joint("low", "base", "low_stage", "prismatic", "0 0 1", more='<dynamics damping="1"/>'),
    joint("top", "low_stage", "top_stage", "prismatic", "0 0 1", 'effort="100" lower="0" upper="1"',
          '<dynamics damping="2"/><mimic joint="low"/>'),
)  # fmt: skip
TWO = (link("a"), link("b"), joint("j1", "base", "a"), joint("j2", "a", "b"))
