"""A page's data read back from its file, by the words of its format only: no code of the library."""

import base64
import gzip
import html
import json
import re

import numpy as np


class Page:
    """What stands in a page: header, and arrays by where the header says that they are."""

    def __init__(self, path):
        self.text = path.read_text(encoding="utf-8")
        self.title = html.unescape(re.search("<title>(.*?)</title>", self.text).group(1))
        self.header = json.loads(re.search('id="header">(.*?)</script>', self.text, re.S).group(1))
        self.bytes = gzip.decompress(base64.b64decode(re.search('id="data">(.*?)</script>', self.text, re.S).group(1)))

    def array(self, where, *shape):
        kind = np.dtype(where["kind"]).newbyteorder("<")
        return np.frombuffer(self.bytes, kind, where["length"], where["offset"]).reshape(shape or -1)

    def shape(self, name):
        return next(shape for shape in self.header["shapes"] if shape["name"] == name)

    def patterns(self, name):
        """Displacements of a shape's points by its patterns, (n, 3, r)."""
        patterns = self.header["forms"][self.shape(name)["form"]]["patterns"]
        values = self.array(patterns["values"]).reshape(len(patterns["scales"]), -1, 3)
        return np.einsum("rnk,r->nkr", values.astype(float), patterns["scales"])

    def mode(self, number, name):
        """Displacement of a shape's points in a mode, along the shape's axes, (n, 3)."""
        mode = self.header["modes"][number]
        return mode["peak"] * self.patterns(name) @ np.array(mode["coordinates"][name])

    def moved(self, name, what, *shape):
        return self.array(self.header["motion"]["moved"][name][what], *shape)
