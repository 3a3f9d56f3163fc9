"""A private certificate authority for one site: one certificate for the service, one for every rig, one for every person.

Certificates last a year and are renewed before. To revoke one is to give its bearer a new common name (``kim~2`` after ``kim``): the service
obeys only the newest, which stands in ``names.json`` beside the keys, so what was stolen opens nothing. The service takes up new files
of this folder while it runs; rigs and viewers read theirs whenever they connect.
"""

from __future__ import annotations

import datetime
import ipaddress
import json
import os
import ssl
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.files.site import Security, Site
from afdsvc.wire.keys import SERVICE

AUTHORITY = "ca"
DAYS, AUTHORITY_DAYS = 365, 3650
RENEWED_DAYS = 30  # before its end a certificate is renewed when somebody asks for it, and warned of
NAMES = "names.json"
_MISSING = "making certificates needs the extra 'tls': install afdsvc[tls]"


def rig_name(machine: str) -> str:
    """Return the name of a rig agent's certificate."""
    return f"rig.{machine}"


@dataclass(frozen=True, slots=True)
class KeyFiles:
    """The files one process needs: the authority's certificate, its own certificate and private key."""

    authority: Path
    certificate: Path
    private_key: Path


def key_files(security: Security, name: str) -> KeyFiles:
    """Return the files of one common name; raises `BadInput` naming the file that is not there."""
    files = KeyFiles(*(security.keys / part for part in (f"{AUTHORITY}.pem", f"{name}.pem", f"{name}.key")))
    for path in (files.authority, files.certificate, files.private_key):
        if not path.is_file():
            raise BadInput(f"{path}: does not exist; 'afdsvc certificates SITE.toml' makes it, and each computer needs its own")
    return files


def names_of(site: Site) -> list[str]:
    """Return the common names a site needs certificates for; raises `BadInput` when it has no ``transport.security``."""
    security = site.transport.security
    if security is None:
        raise BadInput(f"{site.origin}: key 'transport.security' is missing; its 'keys' says where the certificates go")
    return [SERVICE, *(rig_name(m.id) for m in site.machines), *dict.fromkeys([*security.operators, *security.viewers, *security.tuners])]


def make_certificates(site: Site, days: int = DAYS, renew: bool = False, revoke: Sequence[str] = ()) -> list[Path]:
    """Make what is missing in the folder of keys and return the new files; what is there is replaced only when asked for.

    ``renew`` replaces certificates that end within `RENEWED_DAYS`. ``revoke`` names people or rigs whose certificates are void from now on:
    they get new ones. Private keys are readable by their owner only. The authority's own key (``ca.key``) is needed to add a machine or a
    person later and belongs on no machine: keep it elsewhere.
    """
    names, security = names_of(site), site.transport.security
    folder = security.keys if security else Path()
    for name in revoke:
        if name not in names or name == SERVICE:
            raise BadInput(f"'{name}' cannot be revoked; expected one of {', '.join(names[1:])} (a stolen key of the service needs a new authority)")
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        authority, made = _authority(folder, site.site, AUTHORITY_DAYS)
        if revoke:
            numbers = _numbers(folder)
            _replace(folder / NAMES, json.dumps(numbers | {name: numbers.get(name, 1) + 1 for name in revoke}).encode(), 0o644)
        for name in names:
            path = folder / f"{name}.pem"
            if not path.exists() or name in revoke or (renew and days_left(path) < RENEWED_DAYS):
                made += _issue(folder, name, authority, _hosts(site.transport.endpoints()), days)
    except OSError as error:
        raise BadInput(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    return made


def days_left(certificate: Path) -> float:
    """Return for how many days a certificate is valid yet; negative afterwards."""
    x509 = _library()[0]
    end = x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc
    return float((end - datetime.datetime.now(datetime.UTC)).total_seconds() / 86400)


def ending(security: Security) -> list[str]:
    """Return a sentence for every certificate in the folder of keys that ends within `RENEWED_DAYS`, or has ended."""
    left = {path: days_left(path) for path in sorted(security.keys.glob("*.pem"))}
    how = "'afdsvc certificates SITE.toml --renew' makes a new one"
    return [f"{path}: {'ends in' if days >= 0 else 'ended'} {abs(days):.0f} days{' ago' if days < 0 else ''}; {how}" for path, days in left.items() if days < RENEWED_DAYS]


def check_pair(files: KeyFiles) -> None:
    """Raise `BadInput` when certificate and private key cannot be used together: half of a pair may have been copied."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(files.certificate, files.private_key)
    except (OSError, ssl.SSLError) as error:
        raise BadInput(f"{files.certificate}: cannot be used with {files.private_key.name}: {error}") from None


def common_name(security: Security, name: str) -> str:
    """Return the common name that the newest certificate of a bearer has: its name, with a number when others were revoked."""
    number = _numbers(security.keys).get(name, 1)
    return name if number == 1 else f"{name}~{number}"


def _numbers(folder: Path) -> dict[str, int]:
    try:
        found = json.loads((folder / NAMES).read_text())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise BadInput(f"{folder / NAMES}: cannot be read: {error}; it says which certificates are revoked") from None
    if not isinstance(found, dict) or not all(isinstance(n, int) for n in found.values()):
        raise BadInput(f"{folder / NAMES}: expected an object of numbers; it says which certificates are revoked")
    return found


def _hosts(endpoints: Iterable[str]) -> list[str]:
    hosts = [e.partition("/")[2].split("#")[0].rsplit(":", 1)[0].strip("[]") for e in endpoints]
    return sorted({h for h in hosts if h not in ("0.0.0.0", "::")} | {"127.0.0.1", "localhost"})


def _authority(folder: Path, site: str, days: int) -> tuple[tuple[Any, Any], list[Path]]:
    """Return the authority's certificate and key, made when there are none."""
    x509, _, serialization, ec, _ = _library()
    certificate, key = folder / f"{AUTHORITY}.pem", folder / f"{AUTHORITY}.key"
    if not certificate.exists():
        secret = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"afdsvc {site}")
        made = _sign(name, name, secret, secret, [], days, True)
        return (made, secret), _keep(folder, AUTHORITY, made, secret)
    if not key.exists():
        raise BadInput(f"{key}: is not there; the authority's key is needed to make further certificates")
    secret = serialization.load_pem_private_key(key.read_bytes(), None)
    return (x509.load_pem_x509_certificate(certificate.read_bytes()), secret), []


def _issue(folder: Path, name: str, authority: tuple[Any, Any], hosts: Sequence[str], days: int) -> list[Path]:
    _, _, _, ec, _ = _library()
    secret = ec.generate_private_key(ec.SECP256R1())
    reached_at = hosts if name == SERVICE else [name]
    number = _numbers(folder).get(name, 1)
    made = _sign(_name(name if number == 1 else f"{name}~{number}"), authority[0].subject, secret, authority[1], reached_at, days, False)
    return _keep(folder, name, made, secret)


def _sign(subject: Any, issuer: Any, key: Any, signer: Any, hosts: Sequence[str], days: int, authority: bool) -> Any:
    x509, hashes, _, _, usage = _library()
    now = datetime.datetime.now(datetime.UTC)
    builder = (
        x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key.public_key())
        .serial_number(x509.random_serial_number()).not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(authority, 0 if authority else None), True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), False)
    )  # fmt: skip
    if not authority:
        builder = builder.add_extension(x509.SubjectAlternativeName([_host(x509, h) for h in hosts]), False)
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage.SERVER_AUTH, usage.CLIENT_AUTH]), False)
    return builder.sign(signer, hashes.SHA256())


def _host(x509: Any, host: str) -> Any:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _name(common: str) -> Any:
    x509 = _library()[0]
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, common)])


def _keep(folder: Path, name: str, certificate: Any, key: Any) -> list[Path]:
    _, _, serialization, _, _ = _library()
    paths = [folder / f"{name}.key", folder / f"{name}.pem"]
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )  # fmt: skip
    _replace(paths[0], secret, 0o600)
    _replace(paths[1], certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    return paths


def _replace(path: Path, data: bytes, mode: int) -> None:
    """Write a file as a whole: nobody sees half of it."""
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def _library() -> tuple[Any, Any, Any, Any, Any]:
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID
    except ImportError:
        raise BadInput(_MISSING) from None
    return x509, hashes, serialization, ec, ExtendedKeyUsageOID
