"""Options that all commands spell alike."""

from typing import Annotated

from cyclopts import Parameter

JsonPath = Annotated[str | None, Parameter(allow_leading_hyphen=True)]
Quiet = Annotated[bool, Parameter(name=("--quiet", "-q"))]
