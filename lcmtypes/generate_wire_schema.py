"""Turns .lcm files into a C++ header that describes their wire layout.

usage: generate_wire_schema.py OUT.hpp FILE.lcm...

lcm-gen's C++ decoders resize their arrays by the counts that stand in the message before they look
whether the bytes are there, so one flipped bit can ask for gigabytes. With the layout as a table, a
message is measured before it is decoded (common/bus/wire.hpp).
"""
import re
import sys

PRIMITIVES = {"int8_t": 1, "byte": 1, "boolean": 1, "int16_t": 2, "int32_t": 4, "int64_t": 8,
              "float": 4, "double": 8}
KINDS = {"int8_t": "kInt8", "byte": "kUint8", "boolean": "kBoolean", "int16_t": "kInt16",
         "int32_t": "kInt32", "int64_t": "kInt64", "float": "kFloat", "double": "kDouble",
         "string": "kString"}


def parse(path):
    with open(path, encoding="utf-8") as file:
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", file.read(), flags=re.S)
    package = re.search(r"package\s+(\w+)\s*;", text).group(1)
    name, body = re.search(r"struct\s+(\w+)\s*\{(.*)\}", text, flags=re.S).groups()
    fields = []
    for statement in (s.strip() for s in body.split(";")):
        if not statement or statement.startswith("const "):
            continue
        match = re.fullmatch(r"([\w.]+)\s+(\w+)((?:\s*\[\s*\w+\s*\])*)", statement)
        if not match:
            sys.exit(f"{path}: cannot read '{statement}'")
        type_name, field_name, dims = match.groups()
        fields.append((type_name, field_name, re.findall(r"\[\s*(\w+)\s*\]", dims)))
    return package, name, fields


def dimension(text, fields, path):
    if text.isdigit():
        return f"{{{text}, -1}}"
    for index, (type_name, name, dims) in enumerate(fields):
        if name == text and not dims and type_name.startswith("int"):
            return f"{{0, {index}}}"
    sys.exit(f"{path}: dimension '{text}' is not an integer member")


def main():
    out, paths = sys.argv[1], sys.argv[2:]
    structs = {}
    for path in paths:
        package, name, fields = parse(path)
        structs[name] = (package, path, fields)
    lines = ["// Made by generate_wire_schema.py. Do not edit.", "#pragma once", "",
             '#include "bus/wire_layout.hpp"', ""]
    lines += [f"#include <gastronaut/{name}.hpp>" for name in structs]
    lines += ["", "namespace gastronaut {"]
    done = set()

    def emit(name):
        if name in done:
            return
        package, path, fields = structs[name]
        for type_name, _, _ in fields:
            if type_name.split(".")[-1] in structs:
                emit(type_name.split(".")[-1])
        done.add(name)
        lines.append(f"inline constexpr WireField {name}_fields[] = {{")
        for type_name, field_name, dims in fields:
            bare = type_name.split(".")[-1]
            nested = f"&{bare}_layout" if bare in structs else "nullptr"
            kind = "kStruct" if bare in structs else KINDS[bare]
            shape = [dimension(d, fields, path) for d in dims] + ["{1, -1}"] * (2 - len(dims))
            lines.append(f'    {{"{field_name}", WireKind::{kind}, {nested}, {len(dims)}, '
                         f"{{{{{shape[0]}, {shape[1]}}}}}}},")
        lines.append("};")
        lines.append(f'inline constexpr WireLayout {name}_layout = {{"{package}.{name}", '
                     f"{name}_fields, {len(fields)}}};")
        lines.append(f"template <>\nstruct WireLayoutOf<{name}> {{\n"
                     f"  static constexpr const WireLayout& value = {name}_layout;\n}};")

    for name in structs:
        emit(name)
    lines.append("}  // namespace gastronaut")
    with open(out, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


main()
