"""What each name may do, as Zenoh's access control of the telemetry process. What is not allowed here is refused.

Commands and changes of parameters come in below `by/<name>/`, and each name is let in below its own only: the key
proves who sent a command. Names are the common names of certificates.
"""

import json
import re
from pathlib import Path
from typing import Any, Final, NamedTuple

from servohil.hil.small_file import read_small_text

ACCESS_BYTES: Final = 1 << 20
NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
ALLOWED_NAME: Final = "1 to 32 letters, digits, - and _, the first a letter or digit"
# What anybody with a certificate may ask for; `param` is read there, never set.
READABLE: Final = ("meta", "schema/**", "event/**", "param/**")
COMMANDED: Final = ("cmd/**", "param/**")


class AccessError(ValueError):
    """An access control that would let strangers in, or no access control at all."""


class People(NamedTuple):
    """Names by what they may do."""

    operators: tuple[str, ...]
    viewers: tuple[str, ...]


def access_control(rig: str, people: People) -> dict[str, Any]:
    """The `access_control` section of Zenoh's configuration for the rig of that name (`*`: for every rig)."""
    root = f"servohil/v1/{rig}"
    everybody = [*people.operators, *people.viewers]
    rules = [
        _rule("subscribe", "ingress", ["declare_subscriber", *_LIVELINESS], [f"{root}/**"]),
        _rule("ask", "ingress", ["query"], [f"{root}/{key}" for key in READABLE]),
        _rule("tell", "egress", ["put", "reply", "declare_queryable", "liveliness_token"], [f"{root}/**"]),
        # So that an operator who uses the keys of loopback is told which ones to use instead.
        _rule("hear-why-not", "ingress", ["query"], [f"{root}/cmd/**"]),
        *(
            _rule(f"command-{name}", "ingress", ["query"], [f"{root}/by/{name}/{key}" for key in COMMANDED])
            for name in people.operators
        ),
    ]
    policies = [{"rules": ["subscribe", "ask", "tell"], "subjects": everybody}]
    policies += [{"rules": ["hear-why-not", f"command-{name}"], "subjects": [name]} for name in people.operators]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in everybody],
        "policies": policies,
    }


_LIVELINESS: Final = ("liveliness_query", "declare_liveliness_subscriber")


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def read_access(path: Path) -> dict[str, Any]:
    """The access control in `path`, which must close the door to whom it does not name.

    Raises:
        AccessError: no JSON object, not enabled, allowing by default, or with a subject that is not a common name.
        OSError: cannot be read.
    """
    try:
        content = json.loads(read_small_text(path, ACCESS_BYTES))
    except (ValueError, RecursionError) as error:
        raise AccessError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise AccessError(f"{path}: must be a JSON object, Zenoh's access_control")
    for key, wanted in (("enabled", True), ("default_permission", "deny")):
        if content.get(key) != wanted:
            raise AccessError(f"{path}: {key} = {json.dumps(content.get(key))}: must be {json.dumps(wanted)}")
    subjects = content.get("subjects")
    if not isinstance(subjects, list) or not subjects:
        raise AccessError(f"{path}: subjects: must be a list with at least one entry")
    for subject in subjects:
        names = subject.get("cert_common_names") if isinstance(subject, dict) else None
        if not isinstance(names, list) or not names:
            # Without it the subject would be everybody.
            raise AccessError(f"{path}: subject {json.dumps(subject)[:80]}: must have cert_common_names")
    return content
