"""What traced paths bring, for the present temperatures, emissivities and coefficients."""

from jaxir.transport.evaluation._evaluate import Orders as Orders
from jaxir.transport.evaluation._evaluate import bounced as bounced
from jaxir.transport.evaluation._evaluate import evaluate as evaluate
from jaxir.transport.evaluation._evaluate import evaluate_orders as evaluate_orders
from jaxir.transport.evaluation._evaluate import radiance_before_air as radiance_before_air
from jaxir.transport.evaluation._scattered import aimed as aimed
from jaxir.transport.evaluation._scattered import unaimed as unaimed
from jaxir.transport.evaluation._scattered import with_scattered as with_scattered
from jaxir.transport.evaluation._segments import behind_plumes as behind_plumes
from jaxir.transport.evaluation._segments import on_nodes as on_nodes
from jaxir.transport.evaluation._segments import unoccluded_radiance as unoccluded_radiance
