"""STEP files of assemblies whose parts are placed several times, as CAD programs write them.

Netgen writes single parts only. Here the text of such parts is joined, and placed instances of them are added.
"""

import re
import tempfile
from pathlib import Path

import numpy as np


def write_assembly(path, parts, instances, *, name="machine"):
    """Write an assembly, and return the path.

    parts: OpenCASCADE shapes by the name of the part [mm]
    instances: name of the part, name of the instance, position (3,) [mm], rotation (3, 3) of each
    """
    lines, definitions = [], {}
    for k, (part, shape) in enumerate(parts.items(), start=1):
        text = _shifted(_data(shape), 100_000 * k)
        text = re.sub(r"PRODUCT\('[^']*',\s*'[^']*'", f"PRODUCT('{part}','{part}'", text)
        lines.append(text)
        property_, representation = re.search(r"SHAPE_DEFINITION_REPRESENTATION\((#\d+),(#\d+)\)", text).groups()
        definition = re.search(rf"{property_} = PRODUCT_DEFINITION_SHAPE\('','',(#\d+)\)", text)[1]
        origin, context = re.search(
            rf"{representation} = \w*SHAPE_REPRESENTATION\('[^']*',\((#\d+).*?\),(#\d+)\);", text, re.DOTALL
        ).groups()
        definitions[part] = (definition, representation, origin, context)
    context = next(iter(definitions.values()))[3]
    lines.append(f"""#1 = APPLICATION_CONTEXT('design');
#2 = PRODUCT_CONTEXT('',#1,'mechanical');
#3 = PRODUCT('{name}','{name}','',(#2));
#4 = PRODUCT_DEFINITION_FORMATION('','',#3);
#5 = PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#6 = PRODUCT_DEFINITION('design','',#4,#5);
#7 = PRODUCT_DEFINITION_SHAPE('','',#6);
#8 = SHAPE_DEFINITION_REPRESENTATION(#7,#9);""")
    places = []
    for k, (part, instance, position, rotation) in enumerate(instances, start=1):
        n = 100 * k
        definition, representation, origin, _ = definitions[part]
        turn = np.asarray(rotation, dtype=float)
        places.append(f"#{n}")
        lines.append(f"""#{n} = AXIS2_PLACEMENT_3D('',#{n + 1},#{n + 2},#{n + 3});
#{n + 1} = CARTESIAN_POINT('',{_numbers(position)});
#{n + 2} = DIRECTION('',{_numbers(turn[:, 2])});
#{n + 3} = DIRECTION('',{_numbers(turn[:, 0])});
#{n + 4} = CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{n + 5},#{n + 7});
#{n + 5} = ( REPRESENTATION_RELATIONSHIP('','',{representation},#9)
REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{n + 6}) SHAPE_REPRESENTATION_RELATIONSHIP() );
#{n + 6} = ITEM_DEFINED_TRANSFORMATION('','',{origin},#{n});
#{n + 7} = PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',#{n + 8});
#{n + 8} = NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}','{instance}','',#6,{definition},$);""")
    lines.append(f"#9 = SHAPE_REPRESENTATION('',({','.join(places)}),{context});")
    head = "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    head += "FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n"
    path.write_text(head + "\n".join(lines) + "\nENDSEC;\nEND-ISO-10303-21;\n", encoding="latin-1")
    return path


def _data(shape):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.step"
        shape.WriteStep(str(file))
        return re.search(r"DATA;\n(.*)ENDSEC;", file.read_text(), re.DOTALL)[1]


def _shifted(text, offset):
    """Add a number to the numbers of all entities."""
    return re.sub(r"#(\d+)", lambda match: f"#{int(match[1]) + offset}", text)


def _numbers(values):
    return "(" + ",".join(f"{value:.16E}" for value in values) + ")"
