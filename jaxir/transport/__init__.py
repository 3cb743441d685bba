"""How light travels: trace once where rays go, evaluate as often as values change."""

from jaxir.transport._brightness import brightness as brightness
from jaxir.transport._brightness import graded_cameras as graded_cameras
from jaxir.transport._brightness import share_outside as share_outside
from jaxir.transport._direct import mis_weight as mis_weight
from jaxir.transport._estimators import AbstractPathEstimator as AbstractPathEstimator
from jaxir.transport._estimators import CellSum as CellSum
from jaxir.transport._estimators import CombinedIntegration as CombinedIntegration
from jaxir.transport._estimators import LineIntegration as LineIntegration
from jaxir.transport._estimators import PointIntegration as PointIntegration
from jaxir.transport._estimators import estimate as estimate
from jaxir.transport._evaluate import Orders as Orders
from jaxir.transport._evaluate import evaluate as evaluate
from jaxir.transport._evaluate import evaluate_orders as evaluate_orders
from jaxir.transport._evaluate import unoccluded_radiance as unoccluded_radiance
from jaxir.transport._method import ClosedForm as ClosedForm
from jaxir.transport._method import DirectSampling as DirectSampling
from jaxir.transport._method import Method as Method
from jaxir.transport._method import PlumeLight as PlumeLight
from jaxir.transport._method import SkinLight as SkinLight
from jaxir.transport._method import concavity as concavity
from jaxir.transport._paths import LightSamples as LightSamples
from jaxir.transport._paths import Paths as Paths
from jaxir.transport._paths import Segment as Segment
from jaxir.transport._paths import Vertex as Vertex
from jaxir.transport._trace import store_route as store_route
from jaxir.transport._trace import trace as trace
