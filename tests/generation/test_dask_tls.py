"""TLS to a Dask cluster: the lines of docs/scale.md are run, and each failure names the line that mends it."""

import os
import re
import shutil
import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import dask
import dask_cluster
import pytest
from made_sets import make_plan

from symsol_annot.errors import ClusterError
from symsol_annot.generation.dask.checks import check_scheduler, faults_of_encryption
from symsol_annot.generation.dask.executor import DaskCluster
from symsol_annot.generation.executors import local_processes
from symsol_annot.generation.generate import generate

pytestmark = [
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # Dask's and tornado's own
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
PAGE = (Path(__file__).resolve().parents[2] / "docs/scale.md").read_text()
MAKE_CERTIFICATES, START_CLUSTER, RENDER = re.findall(
    r"```sh\n(.*?)```", PAGE.split("\n## TLS\n")[1].split("\n## ")[0], re.DOTALL
)
CALL_MAIN = "from symsol_annot_cli.main import main; main()"
GREETING = (
    b":\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0*\0\0\0\0\0\0\0\x83\xabcompression\xc0\xa6python\x93\3\x0b\7\xafpickle-protocol\5"
)


def openssl(folder, *words):
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True, timeout=60)


def sign(folder, name, *options):
    """Write a certificate of the node's key, signed by the folder's CA."""
    signer = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial")
    openssl(folder, "x509", "-req", "-in", "node.csr", *signer, "-out", name, *options)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """A folder with the certificates of the page, and in `other` those of another CA; and some that are wrong."""
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "other").mkdir()
    for where in (folder, folder / "other"):
        subprocess.run(["bash", "-ec", MAKE_CERTIFICATES], cwd=where, check=True, capture_output=True, timeout=60)
    sign(folder, "expired.pem", "-days", "-1")
    (folder / "client-only.cnf").write_text("extendedKeyUsage=clientAuth\n")
    sign(folder, "client-only.pem", "-extfile", "client-only.cnf")
    (folder / "server-only.cnf").write_text("extendedKeyUsage=serverAuth\n")
    sign(folder, "server-only.pem", "-extfile", "server-only.cnf")
    (folder / "both.pem").write_bytes((folder / "node.key").read_bytes() + (folder / "node.pem").read_bytes())
    openssl(folder, "pkey", "-in", "node.key", "-aes128", "-passout", "pass:secret", "-out", "secret.key")
    (folder / "garbled.pem").write_text("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
    (folder / "empty.pem").touch()
    os.mkfifo(folder / "fifo.pem")
    return folder


def tls_options(folder, certificate="node.pem"):
    files = {"--tls-ca-file": "ca.pem", "--tls-cert": certificate, "--tls-key": "node.key"}
    return [word for option, name in files.items() for word in (option, str(folder / name))]


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory, certificates):
    folder = tmp_path_factory.mktemp("scheduler")
    with dask_cluster.scheduler(folder, "--protocol", "tls", *tls_options(certificates)) as address:
        assert address.startswith("tls://")
        yield address


@contextmanager
def configured(folder, ca="ca.pem", certificate="node.pem", key="node.key", **more):
    """Dask's configuration of TLS for this process, as its environment variables would set it."""
    names = {"tls.ca-file": ca, "tls.client.cert": certificate, "tls.client.key": key}
    paths = {name: str(folder / value) if isinstance(value, str) else value for name, value in names.items()}
    with dask.config.set({f"distributed.comm.{name}": value for name, value in (paths | more).items()}):
        yield


def refusal_of(address, within_s=15):
    start = time.monotonic()
    with pytest.raises(ClusterError) as refused:
        check_scheduler(address)
    assert time.monotonic() - start < within_s
    said = str(refused.value)
    assert "no Dask scheduler" not in said
    assert "nobody answers" not in said
    return said


# The lines of the page


def as_here(lines, port):
    """The page's lines for this machine: its loopback, a free port, two worker processes, this Python."""
    lines = lines.replace("10.0.0.1", "127.0.0.1").replace(":8786", f":{port}").replace("--port 8786", f"--port {port}")
    lines = lines.replace("127.0.0.1:8787", "127.0.0.1:0").replace("--nworkers 16", "--nworkers 2")
    lines = re.sub("^dask ", f"exec {sys.executable} -m dask ", lines, flags=re.MULTILINE)
    return re.sub("^symsol-annot ", f"exec {sys.executable} -c '{CALL_MAIN}' ", lines, flags=re.MULTILINE)


@contextmanager
def running(script, folder):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with (folder / "log").open("ab") as log:
        process = subprocess.Popen(["bash", "-ec", script], cwd=folder, env=environment, stdout=log, stderr=log)
        try:
            yield process
        finally:
            process.terminate()
            process.wait(timeout=60)


@pytest.mark.blender
def test_the_lines_of_the_page_make_a_set_over_tls_of_the_bytes_of_local_processes(tmp_path, certificates):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for name in ("ca.pem", "node.pem", "node.key"):
        shutil.copy(certificates / name, tmp_path)
    options, start_scheduler, start_workers = as_here(START_CLUSTER, port).splitlines()
    small = "--object tetX --train 0 --test 8 --size 48 --out made"
    render = as_here(RENDER, port).replace("--object cylO", small)
    assert f"--cluster tls://127.0.0.1:{port}" in render
    with (
        running(f"{options}\n{start_scheduler}", tmp_path),
        listening_at(port),
        running(f"{options}\n{start_workers}", tmp_path),
        running(render, tmp_path) as command,
    ):
        assert command.wait(timeout=600) == 0, (tmp_path / "log").read_text()
    log = (tmp_path / "log").read_text()
    assert "Warning: the connection" not in log
    generate(
        make_plan("tetX", test=8, size=48, annotate="all"),
        tmp_path / "local" / "tetX",
        partial(local_processes, workers=1),
    )
    made, local = (
        {path.name: path.read_bytes() for path in (tmp_path / name / "tetX").iterdir()} for name in ("made", "local")
    )
    assert made == local


@contextmanager
def listening_at(port):
    """Wait for somebody who listens there."""
    end = time.monotonic() + 120
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=5).close()
            break
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)
    yield


def test_the_page_s_variables_are_those_of_which_messages_speak(scheduler):
    with configured(Path(), ca=None, certificate=None, key=None):
        said = refusal_of(scheduler)
    missing = [line for line in RENDER.splitlines() if line.startswith("export ") and "KEY" not in line]
    assert len(missing) == 2
    assert all(f"`{line}`" in said for line in missing)
    assert "docs/scale.md#tls" in said


# Certificates of this side


@pytest.mark.parametrize("change", [{}, {"certificate": "both.pem", "key": None}, {"require-encryption": True}])
def test_a_scheduler_with_tls_is_reached_with_a_certificate_of_its_ca(scheduler, certificates, change):
    with configured(certificates, **change):
        check_scheduler(scheduler)


def test_certificates_may_be_in_the_configuration_itself(scheduler, certificates):
    texts = {"tls.ca-file": "ca.pem", "tls.client.cert": "node.pem", "tls.client.key": "node.key"}
    with configured(certificates, **{name: (certificates / file).read_text() for name, file in texts.items()}):
        check_scheduler(scheduler)


CA, CERT, KEY = (f"DASK_DISTRIBUTED__COMM__TLS__{name}" for name in ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ca": "none.pem"}, rf"tls\.ca-file .*none\.pem: No such file or directory; correct {CA}"),
        ({"ca": "fifo.pem"}, rf"tls\.ca-file .*fifo\.pem: is no regular file; correct {CA}"),
        ({"ca": "/dev/zero"}, rf"/dev/zero: is no regular file; correct {CA}"),
        ({"ca": "other"}, rf"other: is a folder, where a file belongs; correct {CA}"),
        ({"ca": "node.key"}, rf"node\.key: holds no CERTIFICATE in PEM form; correct {CA}"),
        ({"ca": "garbled.pem"}, r"OpenSSL refuses .*openssl x509 -noout -text -in` prints"),
        ({"certificate": None}, rf"no tls\.client\.cert .*`export {CERT}=\$PWD/node\.pem`"),
        ({"certificate": "node.csr"}, rf"node\.csr: holds no CERTIFICATE in PEM form; correct {CERT}"),
        ({"certificate": "garbled.pem"}, r"OpenSSL refuses .*openssl x509 -noout -text -in` prints"),
        ({"certificate": 3}, rf"tls\.client\.cert .*3: expected a path, found int; correct {CERT}"),
        ({"key": None}, rf"no private key in tls\.client\.cert .*`export {KEY}=\$PWD/node\.key`"),
        ({"key": "none.key"}, rf"tls\.client\.key .*none\.key: No such file or directory; correct {KEY}"),
        ({"key": "empty.pem"}, rf"empty\.pem: holds no PRIVATE KEY in PEM form; correct {KEY}"),
        ({"key": "secret.key"}, r"has a passphrase, for which Dask cannot ask: `openssl pkey -in \S+secret\.key -out"),
        ({"key": "other/node.key"}, r"other/node\.key does not belong to the certificate .*`openssl pkey -pubout -in"),
        ({"tls.min-version": 1.0}, r"min-version=1\.0 is not supported"),
        ({"tls.ciphers": "nonsense"}, r"OpenSSL refuses .*Correct tls\.ciphers"),
        ({"tls": 3}, r"configuration of TLS cannot be read"),
    ],
    ids=str,
)
def test_certificates_that_cannot_be_used_are_named_with_the_line_that_mends_it(scheduler, certificates, change, words):
    with configured(certificates, **change):
        assert re.search(words, refusal_of(scheduler, within_s=5))


def test_all_faults_of_this_side_s_certificates_are_told_at_once(scheduler, certificates):
    with configured(certificates, ca="none.pem", certificate="node.csr", key=3):
        said = refusal_of(scheduler)
    assert [line.split(" (")[0] for line in said.splitlines()[1:]] == [
        "  - tls.ca-file",
        "  - tls.client.cert",
        "  - tls.client.key",
    ]


# What the two sides have against each other


def test_a_scheduler_of_another_ca_is_called_that(scheduler, certificates):
    with configured(certificates, ca="other/ca.pem"):
        said = refusal_of(scheduler)
    assert re.search(rf"TLS connection failed: .* not signed by the CA in \S+other/ca\.pem .*`export {CA}=", said)


@pytest.mark.parametrize(
    ("certificate", "key", "words"),
    [
        (
            "other/node.pem",
            "other/node.key",
            rf"does not know the CA that signed .*other/node\.pem.*--tls-ca-file; {CERT}",
        ),
        ("expired.pem", "node.key", rf"expired\.pem, has expired: `openssl x509 -noout -dates -in \S+`.*{CERT}"),
        (
            "server-only.pem",
            "node.key",
            rf"the scheduler refuses this command's certificate, \S+server-only\.pem .*{CERT}",
        ),
    ],
)
@pytest.mark.parametrize("version", [1.2, None], ids=["TLS 1.2", "TLS 1.3"])
def test_what_a_scheduler_has_against_this_side_s_certificate_is_said(
    scheduler, certificates, certificate, key, words, version
):
    with configured(certificates, certificate=certificate, key=key, **{"tls.max-version": version}):
        assert re.search(f"TLS connection failed: .*{words}", refusal_of(scheduler))


def test_two_sides_without_a_cipher_in_common_are_told_so(scheduler, certificates):
    strange = {"tls.max-version": 1.2, "tls.ciphers": "ECDHE-RSA-CAMELLIA256-SHA384"}
    with configured(certificates, **strange):
        assert "no version of TLS, or no cipher, in common" in refusal_of(scheduler)


@contextmanager
def serving(certificates, certificate="node.pem", oldest=None, says=GREETING):
    """A server with TLS that wants a certificate as Dask does, and greets so."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=certificates / "ca.pem")
    context.load_cert_chain(certificates / certificate, certificates / "node.key")
    context.verify_mode = ssl.CERT_REQUIRED
    context.minimum_version = oldest or context.minimum_version
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            while True:
                try:
                    with context.wrap_socket(server.accept()[0], server_side=True) as connection:
                        connection.sendall(says)
                        connection.recv(1)
                except ssl.SSLError:
                    continue
                except OSError:
                    return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"tls://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        thread.join(timeout=10)


@pytest.mark.parametrize(
    ("certificate", "words"),
    [
        ("expired.pem", r"the scheduler's certificate has expired, .*docs/scale\.md#tls .*--tls-cert"),
        ("client-only.pem", r"the scheduler's certificate is not made for a server: leave extendedKeyUsage out"),
    ],
)
def test_what_this_side_has_against_a_scheduler_s_certificate_is_said(certificates, certificate, words):
    with serving(certificates, certificate) as address, configured(certificates):
        assert re.search(f"TLS connection failed: {words}", refusal_of(address))


def test_a_scheduler_that_wants_a_newer_tls_is_told_so(certificates):
    newer, older = ssl.TLSVersion.TLSv1_3, {"tls.max-version": 1.2}
    with serving(certificates, oldest=newer) as address, configured(certificates, **older):
        assert "no version of TLS, or no cipher, in common" in refusal_of(address)


def test_a_server_with_tls_that_is_no_scheduler_is_called_that(certificates):
    with (
        serving(certificates, says=b"HTTP/1.1 400 Bad Request\r\n\r\n") as address,
        configured(certificates),
        pytest.raises(ClusterError, match="something that is no Dask scheduler answers there"),
    ):
        check_scheduler(address)


# TLS on one side alone


def test_a_scheduler_without_tls_behind_a_tls_address_is_called_that(tmp_path, certificates):
    with dask_cluster.scheduler(tmp_path) as address, configured(certificates):
        said = refusal_of(address.replace("tcp://", "tls://"))
    assert (
        "a Dask scheduler without TLS answers there. Start it with `dask scheduler --protocol tls --tls-ca-file" in said
    )
    assert "REQUIRE_ENCRYPTION=True" in said
    assert f"--cluster {address}" in said


def test_a_scheduler_with_tls_behind_a_tcp_address_is_called_that(scheduler):
    said = refusal_of(scheduler.replace("tls://", "tcp://"))
    assert f"a server that speaks TLS answers there, and waits for it. Give --cluster {scheduler}" in said


def test_plain_tcp_is_refused_unasked_where_dask_s_configuration_requires_encryption(certificates):
    with configured(certificates, **{"require-encryption": True}):
        said = refusal_of("tcp://127.0.0.1:1", within_s=2)
    assert "distributed.comm.require-encryption demands" in said
    assert "Give tls://127.0.0.1:1" in said


@pytest.mark.parametrize("scheduler", ["tls://10.0.0.1:8786", "tcp://10.0.0.1:8786"])
def test_workers_without_tls_are_a_fault_where_the_scheduler_has_it(scheduler):
    faults = faults_of_encryption(scheduler, ["tcp://10.0.0.2:1", "tls://10.0.0.3:1"])
    expected = (
        "tcp://10.0.0.2:1 listens without TLS: start it with `dask worker tls://10.0.0.1:8786 --protocol tls --tls-"
    )
    assert [fault.startswith(expected) for fault in faults] == ([True] if scheduler.startswith("tls") else [])


def test_a_real_worker_without_tls_is_refused_before_work(tmp_path, certificates, monkeypatch):
    """Certificates in the environment, and no require-encryption: then Dask lets a worker listen as it likes."""
    monkeypatch.setenv(CA, str(certificates / "ca.pem"))
    for who in ("SCHEDULER", "WORKER"):
        monkeypatch.setenv(CERT.replace("CLIENT", who), str(certificates / "node.pem"))
        monkeypatch.setenv(KEY.replace("CLIENT", who), str(certificates / "node.key"))
    with (
        dask_cluster.scheduler(tmp_path, "--protocol", "tls") as address,
        dask_cluster.workers(tmp_path, address, 1, "--protocol", "tcp"),
        configured(certificates),
        pytest.raises(ClusterError, match=f"start it with `dask worker {address} --protocol tls --tls-ca-file"),
    ):
        generate(make_plan("tetX", test=1), tmp_path / "tetX", partial(DaskCluster, address=address))
    assert not (tmp_path / "tetX").exists()
