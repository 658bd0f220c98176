"""Everything about models."""

from collections.abc import Sequence
from typing import Any

from starlette.routing import BaseRoute

from drcli.web.download_folder import DownloadFolder
from drcli.web.model_action_routes import action_routes
from drcli.web.model_detail_routes import detail_routes
from drcli.web.model_file_routes import file_routes
from drcli.web.model_import_routes import import_routes
from drcli.web.model_list_routes import list_routes
from drcli.web.model_reader import ModelReader
from drcli.web.served_folder import ServedFolder


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    reader = ModelReader(folder)
    downloads = DownloadFolder(folder.directory)
    analyses: dict[str, Any] = {}
    return [
        *list_routes(reader),
        *detail_routes(reader),
        *file_routes(reader, downloads, analyses),
        *action_routes(reader, downloads, analyses),
        *import_routes(reader),
    ]
