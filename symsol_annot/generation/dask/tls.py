"""TLS on the way to a Dask scheduler: the certificates of this side, and what a failed handshake means."""

import os
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from distributed import Security

from symsol_annot.errors import ClusterError, bulleted
from symsol_annot.system.reading import read_bytes

GUIDE = "docs/scale.md#tls"
TLS_OPTIONS = " --tls-ca-file ca.pem --tls-cert node.pem --tls-key node.key"  # of `dask scheduler` and `dask worker`
_FILE_LIMIT = 2**20  # bytes; a system's bundle of all public CAs has 200 kB
_VARIABLES = "DASK_DISTRIBUTED__COMM__"

_EXPIRED, _NOT_YET_VALID, _UNFIT_PURPOSE = 10, 9, 26  # X509_V_ERR_... of OpenSSL
_UNKNOWN_CA = (2, 7, 18, 19, 20, 21, 30)  # 7 and 30: of another CA with the same name, as the same lines make it
_VERSIONS_DIFFER = ("PROTOCOL_VERSION", "UNSUPPORTED_PROTOCOL", "HANDSHAKE_FAILURE", "NO_CIPHERS", "NO_SHARED_CIPHER")
_CA_REFUSED = ("UNKNOWN_CA", "DECRYPT_ERROR")  # the latter of one with the same name
_CERTIFICATE_REFUSED = ("CERTIFICATE", "ACCESS_DENIED", "INSUFFICIENT_SECURITY")


@dataclass(frozen=True)
class _PemSetting:
    """A setting of Dask's that names a file in PEM form.

    Attributes:
        name: as in Dask's configuration, below distributed.comm.
        field: as in Dask's `get_tls_config_for_role`.
        holds: in words.
        kind: what PEM calls it.
        example: a file's name.
    """

    name: str
    field: str
    holds: str
    kind: str
    example: str

    @property
    def mark(self) -> bytes:
        """What such a file has in it."""
        return f"{self.kind}-----".encode()

    @property
    def variable(self) -> str:
        """The environment variable that sets it."""
        return _VARIABLES + self.name.upper().replace("-", "_").replace(".", "__")


_CA = _PemSetting("tls.ca-file", "ca_file", "the CA's certificate", "CERTIFICATE", "ca.pem")
_CERTIFICATE = _PemSetting("tls.client.cert", "cert", "this command's certificate", "CERTIFICATE", "node.pem")
_KEY = _PemSetting("tls.client.key", "key", "that certificate's private key", "PRIVATE KEY", "node.key")


def is_encryption_required() -> bool:
    """Return whether Dask's configuration forbids connections without TLS.

    Raises:
        ClusterError: the configuration cannot be read.
    """
    return bool(_security().require_encryption)


def client_context() -> ssl.SSLContext:
    """Return the TLS context that Dask makes of its configuration for this command.

    Raises:
        ClusterError: the configuration names no certificates, or some that cannot be used; all faults at once.
    """
    security = _security()
    own: Mapping[str, Any] = security.get_tls_config_for_role("client")
    faults = _faults(own)
    if faults:
        raise ClusterError(
            f"a tls:// address needs certificates for this command too ({GUIDE} says how to make them). In Dask's "
            "configuration, below distributed.comm:\n" + bulleted(faults)
        )
    try:
        context = security.get_connection_args("client")["ssl_context"]
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(_refusal_in_words(own, error)) from None
    if not isinstance(context, ssl.SSLContext):
        raise ClusterError(
            f"Dask made no TLS context of its configuration ({context!r}); {GUIDE} says what belongs there"
        )
    return context


def _security() -> Security:
    try:
        return Security()
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ClusterError(
            f"Dask's configuration of TLS cannot be read ({error}). Correct the setting below distributed.comm, in a "
            f"variable {_VARIABLES}... or a file of Dask's; {GUIDE} says what belongs there"
        ) from None


def _faults(own: Mapping[str, Any]) -> list[str]:
    """Say what keeps Dask from using the files: a line each."""
    found: dict[str, bytes] = {}
    faults = []
    for setting in (_CA, _CERTIFICATE, _KEY):
        value = own[setting.field]
        if value in (None, ""):
            if setting is not _KEY:
                faults.append(
                    f"no {setting.name} ({setting.holds}): `export {setting.variable}=$PWD/{setting.example}`"
                )
            continue
        try:
            found[setting.field] = _pem(value)
        except (OSError, ValueError) as error:
            why = (isinstance(error, OSError) and error.strerror) or str(error)
            faults.append(f"{_shown(setting, value)}: {why}; correct {setting.variable}")
            continue
        if setting.mark not in found[setting.field]:
            faults.append(f"{_shown(setting, value)}: holds no {setting.kind} in PEM form; correct {setting.variable}")
    return faults or _faults_of_key(own, found)


def _faults_of_key(own: Mapping[str, Any], found: Mapping[str, bytes]) -> list[str]:
    """Say what is wrong with the private key; Dask looks for it beside the certificate where none is configured."""
    setting = _KEY if "key" in found else _CERTIFICATE
    key = found[setting.field]
    if _KEY.mark not in key:
        where = _shown(setting, own["cert"])
        return [f"no {_KEY.name}, and no private key in {where}: `export {_KEY.variable}=$PWD/{_KEY.example}`"]
    if b"ENCRYPTED" in key:  # OpenSSL would ask for its passphrase, on the terminal
        where = _shown(setting, own[setting.field])
        rewrite = f"openssl pkey -in {quote(_path(own[setting.field]))} -out plain.key"
        return [f"{where}: has a passphrase, for which Dask cannot ask: `{rewrite}`, and give that as {_KEY.variable}"]
    return []


def _pem(value: object) -> bytes:
    """Return what the file holds that a setting names; a value of several lines is PEM itself, as for Dask."""
    if not isinstance(value, str):
        raise ValueError(f"expected a path, found {type(value).__name__}")  # noqa: TRY004 - told as a fault of a file
    return value.encode() if "\n" in value else read_bytes(Path(value), _FILE_LIMIT)


def _shown(setting: _PemSetting, value: object) -> str:
    named = f"{setting.name} ({setting.holds})"
    return f"{named}, in memory" if isinstance(value, str) and "\n" in value else f"{named}, {value}"


def _refusal_in_words(own: Mapping[str, Any], error: Exception) -> str:
    certificate, key = (_path(own[field]) for field in ("cert", "key"))
    if "KEY_VALUES_MISMATCH" in str(error):
        return (
            f"the private key {key or certificate} does not belong to the certificate {certificate}: "
            f"`openssl pkey -pubout -in {quote(key or certificate)}` and "
            f"`openssl x509 -noout -pubkey -in {quote(certificate)}` must print the same. Correct "
            f"{_KEY.variable} or {_CERTIFICATE.variable}"
        )
    return (
        f"OpenSSL refuses what Dask's configuration of TLS says ({error}). Correct tls.ciphers if they are set; "
        f"`openssl x509 -noout -text -in` prints the certificates {_path(own['ca_file'])} and {certificate}, `openssl "
        f"pkey -noout -check -in` checks the key {key or certificate}, and {GUIDE} says how to make new ones"
    )


def _path(value: object) -> str:
    return "" if not value else "in memory" if "\n" in str(value) else os.fspath(str(value))


def failure_in_words(error: ssl.SSLError) -> str | None:
    """Return what a failed handshake means and how to mend it; None where the other side speaks no TLS."""
    own: Mapping[str, Any] = _security().get_tls_config_for_role("client")
    reason = error.reason or ""
    if isinstance(error, ssl.SSLCertVerificationError):
        return _certificate_in_words(error, _path(own["ca_file"]))
    if any(word in reason for word in _VERSIONS_DIFFER):
        return (
            "the two sides have no version of TLS, or no cipher, in common. Give both the same "
            "distributed.comm.tls.min-version, max-version and ciphers, or none"
        )
    return _alert_in_words(reason, _path(own["cert"])) if "ALERT" in reason else None


def _alert_in_words(reason: str, certificate: str) -> str:
    """Return what the scheduler has against this command's certificate."""
    names = f"{_CERTIFICATE.variable} and {_KEY.variable} name it and its key"
    if any(word in reason for word in _CA_REFUSED):
        return (
            f"the scheduler does not know the CA that signed this command's certificate, {certificate}. Use one that "
            f"is signed by the CA of the scheduler's --tls-ca-file; {names}"
        )
    if "CERTIFICATE_EXPIRED" in reason:
        return (
            f"this command's certificate, {certificate}, has expired: `openssl x509 -noout -dates -in "
            f"{quote(certificate)}` says when. Make a new one as {GUIDE} says; {names}"
        )
    if any(word in reason for word in _CERTIFICATE_REFUSED):
        return (
            f"the scheduler refuses this command's certificate, {certificate} ({reason}). Make one as {GUIDE} says; "
            f"{names}"
        )
    return f"the other side ended the handshake ({reason}). The scheduler's log says why"


def _certificate_in_words(error: ssl.SSLCertVerificationError, ca_file: str) -> str:
    """Return what this side has against the scheduler's certificate."""
    if error.verify_code in _UNKNOWN_CA:
        return (
            f"the certificate that is shown there is not signed by the CA in {ca_file} ({error.verify_message}). "
            f"`export {_CA.variable}=...` with the file that the scheduler has as --tls-ca-file; if that is this one, "
            "then somebody else answers there"
        )
    what = {
        _EXPIRED: "has expired, or that of the CA that signed it",
        _NOT_YET_VALID: "is not valid yet: compare the clocks of the two machines",
        _UNFIT_PURPOSE: "is not made for a server: leave extendedKeyUsage out, or name serverAuth and clientAuth in it",
    }.get(error.verify_code, f"is refused here ({error.verify_message})")
    return (
        f"the scheduler's certificate {what}. Make a new one as {GUIDE} says, and start the scheduler and the workers "
        "with it as --tls-cert"
    )
