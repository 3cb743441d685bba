"""Spectral nodes of several kinds in one program."""

import numpy as np

from jaxir._arrays import as_float
from jaxir.optics.spectrum import Nodes


def side_by_side(*several: Nodes) -> Nodes:
    """Nodes whose bands are those of each in turn, so that what all of them show is seen at once."""

    def joined(name):
        return as_float(np.concatenate([np.asarray(getattr(nodes, name)) for nodes in several]))

    each = {name: joined(name) for name in ("lower", "upper", "edge", "g", "slot", "weight")}
    response = np.zeros((sum(len(nodes.names) for nodes in several), len(each["weight"])))
    band = node = 0
    for nodes in several:
        bands, count = nodes.response.shape
        response[band : band + bands, node : node + count] = nodes.response
        band, node = band + bands, node + count
    names = tuple(f"{name} {k}" for k, nodes in enumerate(several) for name in nodes.names)
    error = [np.zeros(len(nodes.names)) if nodes.error is None else np.asarray(nodes.error) for nodes in several]
    return Nodes(**each, response=as_float(response), names=names, error=as_float(np.concatenate(error)))
