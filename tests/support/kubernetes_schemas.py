"""Writes ``tests/data/schemas/kubernetes.json`` from the TypeScript declarations of ``kubernetes-models``.

Run with the folder into which these npm packages were unpacked (see ``tests/data/schemas/README.md``):
``PYTHONPATH=tests python -m support.kubernetes_schemas FOLDER``.
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

KINDS: Final = (
    "v1 PersistentVolumeClaim",
    "v1 Service",
    "apps/v1 Deployment",
    "batch/v1 CronJob",
    "batch/v1 Job",
    "networking.k8s.io/v1 Ingress",
    "networking.k8s.io/v1 NetworkPolicy",
    "policy/v1 PodDisruptionBudget",
    "keda.sh/v1alpha1 ScaledObject",
    "monitoring.coreos.com/v1 ServiceMonitor",
)
"""What the manifests contain: API version and kind."""
FILE: Final = Path(__file__).resolve().parents[1] / "data" / "schemas" / "kubernetes.json"
_COMMENT: Final = re.compile(r"/\*.*?\*/", re.DOTALL)
_CLASS: Final = re.compile(r"export declare class [^{]*({.*?)\n    (?:static|constructor)\b", re.DOTALL)
"""A class repeats all properties of its interface and of those that this extends."""
_ALIAS: Final = re.compile(r"export (?:declare )?type \w+ = ([^;]*);", re.DOTALL)
_RESOURCE: Final = re.compile(r'"apiVersion": "([^"]+)";\s+"kind": "([^"]+)";')
_TOKEN: Final = re.compile(r'"(?:[^"\\]|\\.)*"|\w+|\[\w+: string\]|[{}<>|?:;\[\]()]')
_NAME: Final = re.compile(r"\b\w+ as (I\w+)")
_SIMPLE: Final[dict[str, dict[str, Any]]] = {
    "string": {"type": "string"},
    "number": {"type": "number"},
    "boolean": {"type": "boolean"},
    "object": {"type": "object"},
    "any": {},
    "unknown": {},
    "null": {"type": "null"},
}


class Parser:
    """Reads one TypeScript type and returns it as a JSON schema; objects allow no unknown properties."""

    def __init__(self, text: str) -> None:
        self._tokens: Iterator[str] = (found[0] for found in _TOKEN.finditer(_COMMENT.sub("", text)))
        self._next = next(self._tokens, "")

    def type(self) -> dict[str, Any]:
        """Read a type, which may be a union."""
        options = [self._one()]
        while self._accept("|"):
            options.append(self._one())
        values = [option["const"] for option in options if "const" in option]
        if len(values) == len(options):
            return {"enum": values}
        return options[0] if len(options) == 1 else {"anyOf": options}

    def _one(self) -> dict[str, Any]:
        token = self._take()
        if token == "{":
            return self._object()
        if token == "Array":
            self._expect("<")
            items = self.type()
            self._expect(">")
            return {"type": "array", "items": items}
        if token.startswith('"'):
            return {"const": json.loads(token)}
        if self._accept("["):  # IDeployment["kind"]
            self._take()
            self._expect("]")
            return {"type": "string"}
        return dict(_SIMPLE[token]) if token in _SIMPLE else {"$ref": f"#/$defs/{token}"}

    def _object(self) -> dict[str, Any]:
        properties: dict[str, Any] = {}
        required = []
        others: Any = False
        while not self._accept("}"):
            name = self._take()
            optional = self._accept("?")
            self._expect(":")
            if name.startswith("["):
                others = self.type()
            else:
                properties[name.strip('"')] = self.type()
                if not optional:
                    required.append(name.strip('"'))
            self._accept(";")
        schema = {"type": "object", "properties": properties, "additionalProperties": others}
        return schema | ({"required": required} if required else {})

    def _take(self) -> str:
        token, self._next = self._next, next(self._tokens, "")
        return token

    def _accept(self, token: str) -> bool:
        return self._next == token and bool(self._take())

    def _expect(self, token: str) -> None:
        if (got := self._take()) != token:
            raise ValueError(f"expected {token!r}, got {got!r}")


def read_declarations(folder: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the schemas of all declared types, and the name of the type of each API version and kind."""
    definitions, kinds = {}, {}
    for file in sorted(folder.rglob("*.d.ts")):
        text = _COMMENT.sub("", file.read_text())
        name, declared, alias = _NAME.search(text), _CLASS.search(text), _ALIAS.search(text)
        if name is None or (declared is None and alias is None):
            continue
        body = f"{declared[1]}}}" if declared else alias[1]  # type: ignore[index]
        definitions[name[1]] = Parser(body).type()
        if resource := _RESOURCE.search(text):
            kinds[f"{resource[1]} {resource[2]}"] = name[1]
    return definitions, kinds


def reachable(definitions: dict[str, Any], roots: list[str]) -> dict[str, Any]:
    """Return the definitions that others need, directly or through others."""
    needed: dict[str, Any] = {}
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in needed:
            needed[name] = definitions[name]
            waiting += re.findall(r"#/\$defs/(\w+)", json.dumps(definitions[name]))
    return dict(sorted(needed.items()))


def main(folder: str) -> None:
    """Write the file."""
    definitions, kinds = read_declarations(Path(folder))
    used = {kind: kinds[kind] for kind in KINDS}
    document = {"kinds": used, "$defs": reachable(definitions, list(used.values()))}
    FILE.write_text(json.dumps(document, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
