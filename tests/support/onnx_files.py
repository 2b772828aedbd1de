"""Tiny ONNX networks whose output is what a test says, whatever the image: their bytes, written field by field.

onnx.proto3: a model is a graph of nodes; here GlobalAveragePool, Flatten, Gemm with zero weights, Reshape.
"""

import numpy as np


def varint(number):
    out = b""
    while number > 127:
        out += bytes([number & 127 | 128])
        number >>= 7
    return out + bytes([number])


def field(number, value):
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(name, array, kind):
    dimensions = b"".join(field(1, side) for side in array.shape)
    return dimensions + field(2, kind) + field(8, name) + field(9, array.tobytes())


def node(operator, inputs, output):
    return b"".join(field(1, name) for name in inputs) + field(2, output) + field(3, output) + field(4, operator)


def value(name, shape):
    dimensions = b"".join(field(1, field(1, side) if side else field(2, "any")) for side in shape)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dimensions)))


def network(output, sides=(160, 160)):
    """The file of a network with an input of (1, 3, *sides) that always gives `output`."""
    output = np.asarray(output, np.float32)
    nodes = [
        node("GlobalAveragePool", ["x"], "m"),
        node("Flatten", ["m"], "f"),
        node("Gemm", ["f", "w", "b"], "g"),
        node("Reshape", ["g", "s"], "y"),
    ]
    held = [
        tensor("w", np.zeros((3, output.size), np.float32), 1),
        tensor("b", output.reshape(-1), 1),
        tensor("s", np.array(output.shape, np.int64), 7),
    ]
    graph = b"".join(field(1, each) for each in nodes) + field(2, "g") + b"".join(field(5, each) for each in held)
    graph += field(11, value("x", (1, 3, *sides))) + field(12, value("y", output.shape))
    return field(1, 8) + field(8, field(2, 13)) + field(7, graph)
