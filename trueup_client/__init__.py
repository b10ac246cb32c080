"""What a robot, a CI job or a script needs of trueup: ask, send, fetch, verify. The standard library alone.

from trueup_client import Client

client = Client("http://127.0.0.1:8321")
serving = client.serving("emps")
client.fetch("emps", serving.artifact, "model")
"""

from trueup_client.client import Client
from trueup_client.freshness import Ages, Freshness
from trueup_client.problem import NotSigned, Problem, Rewritten, Unreachable, Untrue
from trueup_client.records import Serving
from trueup_client.robot import Robot
from trueup_client.witness import Witness

__all__ = ["Ages", "Client", "Freshness", "NotSigned", "Problem", "Rewritten", "Robot", "Serving", "Unreachable", "Untrue", "Witness"]
