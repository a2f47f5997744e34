"""The interactive page of `needleplan view`: a server for localhost, and a page that plans while a user drags.

The server is a thin layer over `needleplan.planning`. It needs the extra `view` (starlette, uvicorn). `view` shows the
page of one plan in a notebook, without a server.
"""

from needleplan.page._answers import Opened, Page
from needleplan.page._diagnosis_answers import DiagnosisPage
from needleplan.page._diagnosis_file import DiagnosisFile, is_diagnosis
from needleplan.page._recorded_space import SpaceRun, is_space_run
from needleplan.page._server import HOST, AnyPage, bind, make_server
from needleplan.page._space_answers import SpacePage
from needleplan.page._widget import PlanView, page_of, view

__all__ = [
    "HOST",
    "AnyPage",
    "DiagnosisFile",
    "DiagnosisPage",
    "Opened",
    "Page",
    "PlanView",
    "SpacePage",
    "SpaceRun",
    "bind",
    "is_diagnosis",
    "is_space_run",
    "make_server",
    "page_of",
    "view",
]
