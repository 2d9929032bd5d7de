#!/usr/bin/env python3
"""Fetch the C source of CMSIS-DSP, which Arm's Python package `cmsisdsp` carries, into a folder.

  fetch.py FOLDER

Asks pip's index: PIP_INDEX_URL, else pip's configuration, else pypi.org. pip itself would run the package's build
to read its metadata. Nothing of the package is run here.
"""

import hashlib
import html.parser
import io
import os
import pathlib
import ssl
import subprocess
import sys
import tarfile
import urllib.parse
import urllib.request

NAME, VERSION = "cmsisdsp", "1.10.3"
SHA256 = "307d32298faa7c58db912851027fce35f886fec7eb1a27c4b309ce1a97f47519"
FOLDERS = ("Source", "Include", "PrivateInclude")
TIMEOUT_S = 60


class Links(html.parser.HTMLParser):
    """Where each file of an index page lies."""

    def __init__(self, page):
        super().__init__()
        self.links = []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.links += [link for key, link in attributes if tag == "a" and key == "href" and link]


def index_url():
    asked = subprocess.run([sys.executable, "-m", "pip", "config", "get", "global.index-url"],
                           capture_output=True, text=True)
    return os.environ.get("PIP_INDEX_URL") or asked.stdout.strip() or "https://pypi.org/simple"


def get(url):
    context = ssl.create_default_context(cafile=os.environ.get("PIP_CERT") or None)
    with urllib.request.urlopen(url, timeout=TIMEOUT_S, context=context) as answer:
        return answer.read()


def main():
    folder = pathlib.Path(sys.argv[1])
    page = f"{index_url().rstrip('/')}/{NAME}/"
    file = f"{NAME}-{VERSION}.tar.gz"
    links = [urllib.parse.urljoin(page, link) for link in Links(get(page).decode()).links]
    found = [link for link in links if urllib.parse.urlparse(link).path.endswith("/" + file)]
    if not found:
        sys.exit(f"{page} has no {file}")
    archive = get(found[0])
    digest = hashlib.sha256(archive).hexdigest()
    if digest != SHA256:
        sys.exit(f"{found[0]}: its SHA-256 is {digest}, not {SHA256}")
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        for member in tar:
            # Within the package's own folder, plain files only.
            _, *path = pathlib.PurePosixPath(member.name).parts
            if member.isfile() and path and path[0] in FOLDERS and ".." not in path:
                target = folder.joinpath(*path)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(tar.extractfile(member).read())


if __name__ == "__main__":
    try:
        main()
    except OSError as error:
        sys.exit(f"cannot fetch {NAME} {VERSION}: {error}")
