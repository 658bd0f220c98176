"""The reward function on the page: text, templates, check."""

import ast
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import BaseRoute, Route

from drcli.config.example_files import model_file
from drcli.config.presets import preset_names, preset_of
from drcli.explain.reward_parameter_texts import REWARD_PARAMETERS
from drcli.store.keys import REWARD_FUNCTION_FILE
from drcli.web.answers import accepts, answers, text_of
from drcli.web.own_files import new_text, own_file, save_own_file
from drcli.web.reward_checks import RewardChecks
from drcli.web.served_folder import ServedFolder


def _templates() -> list[dict[str, str]]:
    top = model_file(REWARD_FUNCTION_FILE)
    paths = [("middle", top)]
    folder = model_file("rewards")
    paths += [(path.parent.name, path) for path in sorted(folder.glob(f"*/{top.name}"))]
    found = {name.replace("_", " "): path.read_text("utf-8") for name, path in paths}
    for name in preset_names():
        data = preset_of(name).files.get(top.name)
        text = "" if data is None else data.decode()
        if text and text not in found.values():
            found[name] = text
    return [{"name": name, "about": _about(text), "text": text} for name, text in found.items()]


def _about(text: str) -> str:
    tree = ast.parse(text)
    functions = [each for each in tree.body if isinstance(each, ast.FunctionDef)]
    documents = [ast.get_docstring(tree), *map(ast.get_docstring, reversed(functions))]
    return next((" ".join(each.split("\n\n")[0].split()) for each in documents if each), "")


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    checks = RewardChecks(folder.directory)
    folder.at_end.append(checks.close)

    def show(_: Request) -> Any:
        file = own_file(folder.settings(), REWARD_FUNCTION_FILE)
        return {**file.facts(), "text": file.text}

    def save(_: Request, body: dict[str, Any]) -> Any:
        text = new_text(body)
        settings = folder.settings()
        return save_own_file(settings, REWARD_FUNCTION_FILE, text, text_of(body, "version"))

    def templates(_: Request) -> Any:
        parameters = [
            {"name": name, "kind": text.kind, "unit": text.unit, "meaning": text.meaning}
            for name, text in REWARD_PARAMETERS.items()
        ]
        return {"templates": _templates(), "parameters": parameters}

    def check(_: Request, body: dict[str, Any]) -> Any:
        page, known = text_of(body, "page")[:64], text_of(body, "known", "")[:64]
        answer = checks.check(page, new_text(body).decode(), known)
        return JSONResponse(answer, 422 if "error" in answer else 200)

    return [
        Route("/api/reward", answers(show), methods=["GET"]),
        Route("/api/reward", accepts(save), methods=["PUT"]),
        Route("/api/reward/templates", answers(templates)),
        Route("/api/reward/check", accepts(check), methods=["POST"]),
    ]
