"""A certificate authority of our own: it signs the telemetry process and each person, and nothing else.

X.509 version 3 (RFC 5280), ECDSA on P-256 with SHA-256. What a certificate is for stands in it: a person's cannot pass
for the telemetry process, and no certificate but the authority's can sign.
"""

import ipaddress
from datetime import UTC, datetime, timedelta
from typing import Final, NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

AUTHORITY_DAYS: Final = 3650
CERTIFICATE_DAYS: Final = 825
CLOCK_SLACK: Final = timedelta(hours=1)  # two machines rarely agree on the second


class Signed(NamedTuple):
    """A private key and its certificate, both as PEM."""

    key: bytes
    certificate: bytes


def new_authority(rig: str) -> Signed:
    """A self-signed authority for one rig, valid for AUTHORITY_DAYS. It can sign certificates, not authorities."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"servohil authority of {rig}"[:64])])
    builder = _unsigned(name, name, key.public_key(), AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(signs=True), critical=True)
    return _finish(builder, key, key)


def server_certificate(authority: Signed, hosts: tuple[str, ...]) -> Signed:
    """For the telemetry process, reached as any of `hosts`: names or IP addresses."""
    names: list[x509.GeneralName] = []
    for host in hosts:
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            names.append(x509.DNSName(host))
    return _issue(authority, "telemetry", ExtendedKeyUsageOID.SERVER_AUTH, names)


def client_certificate(authority: Signed, name: str) -> Signed:
    """For a person or a program that connects; `name` is the common name that access control knows."""
    return _issue(authority, name, ExtendedKeyUsageOID.CLIENT_AUTH, [])


def valid_until(certificate: bytes) -> datetime:
    """When a PEM certificate ends, UTC. Raises ValueError if it is none."""
    return x509.load_pem_x509_certificate(certificate).not_valid_after_utc


def common_name(certificate: bytes) -> str:
    """Whom a PEM certificate names. Raises ValueError if it is none, or names nobody."""
    names = x509.load_pem_x509_certificate(certificate).subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if len(names) != 1:
        raise ValueError(f"certificate with {len(names)} common names; expected one")
    return str(names[0].value)


def _issue(authority: Signed, name: str, purpose: x509.ObjectIdentifier, hosts: list[x509.GeneralName]) -> Signed:
    key = ec.generate_private_key(ec.SECP256R1())
    signer = serialization.load_pem_private_key(authority.key, password=None)
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    if not isinstance(signer, ec.EllipticCurvePrivateKey) or signer.public_key() != issuer.public_key():
        raise ValueError("the authority's key does not belong to its certificate")
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    days = min(CERTIFICATE_DAYS, (issuer.not_valid_after_utc - datetime.now(UTC)).days)
    builder = _unsigned(subject, issuer.subject, key.public_key(), days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(signs=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
    identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    builder = builder.add_extension(identifier, critical=False)
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
    return _finish(builder, signer, key)


def _unsigned(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SLACK)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(signs: bool) -> x509.KeyUsage:
    """What the key is for: an authority signs certificates and revocation lists, all others a handshake."""
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _finish(
    builder: x509.CertificateBuilder, signer: ec.EllipticCurvePrivateKey, key: ec.EllipticCurvePrivateKey
) -> Signed:
    certificate = builder.sign(signer, hashes.SHA256())
    return Signed(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()),
        certificate.public_bytes(serialization.Encoding.PEM),
    )
