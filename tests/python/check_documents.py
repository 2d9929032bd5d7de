"""Check the documents: README, contributing page, model card and book.

  check_documents.py SLIPSENSE XTASK

Links lead to files and headings that exist, included files exist, every command that a document names exists with its
options (by `--help` of the two programs, the step list of `cargo xtask test all` and the packages of the workspace),
the README fits one screen, each row of the figures page names a command, and the names on the page "Life of a taxel"
exist in the source. Every fault is printed; the exit status is then 1. Needs the standard library only.
"""

import functools
import json
import pathlib
import re
import shlex
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
BOOK = ROOT / "docs/src"
README = ROOT / "README.md"
README_LINES, README_WORDS = 100, 1000
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
INCLUDE = re.compile(r"\{\{#\w+ ([^\s:}]+)[^}]*\}\}")
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
FENCE = re.compile(r"^```(\w*).*?\n(.*?)^```", re.S | re.M)
# What stands for an argument: capitals, paths, numbers.
SUBCOMMAND = re.compile(r"[a-z][a-z0-9-]*$")


def output(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=ROOT)
    return done.stdout if done.returncode == 0 else ""


@functools.cache
def slug_set(path):
    """The anchors of a page, as GitHub and mdBook make them."""
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def check_links(path, text, faults):
    for target in LINK.findall(text):
        if re.match(r"\w+:", target):
            continue
        file, _, anchor = target.partition("#")
        to = (path.parent / file).resolve() if file else path
        if not to.exists():
            faults.append(f"link to {target}, which does not exist")
        elif anchor and to.suffix == ".md" and anchor not in slug_set(to):
            faults.append(f"link to {target}: the page has no such heading")
    for target in INCLUDE.findall(text):
        if not (path.parent / target).exists():
            faults.append(f"include of {target}, which does not exist")


class Programs:
    """The commands that a document may name."""

    def __init__(self, slipsense, xtask):
        self.programs = {"slipsense": slipsense, "xtask": xtask}
        self.steps = {line.split()[0] for line in output(xtask, "test", "all", "--list").splitlines()}
        packages = json.loads(output("cargo", "metadata", "--no-deps", "--format-version", "1", "--offline"))["packages"]
        self.targets = {package["name"]: {target["name"] for target in package["targets"]} for package in packages}
        self.targets["slipsense-twin"] = {"slipsense-twin"}
        self.aliases = set(re.findall(r"^([\w-]+) = ", (ROOT / ".cargo/config.toml").read_text(), re.M))

    @functools.cache
    def help(self, program, *subcommands):
        """Subcommands and options by the help text."""
        text = output(self.programs[program], *subcommands, "--help")
        commands = re.search(r"^Commands:\n(.*?)(\n\S|\Z)", text, re.S | re.M)
        names = set(re.findall(r"^  ([a-z][\w-]*)", commands[1], re.M)) if commands else set()
        # Without the trainer its commands only say what they need.
        options = None if "needs the feature" in text else set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text))
        return names, options

    def fault(self, words):
        """What is wrong with a command line; None if nothing is."""
        while words and re.match(r"[A-Z_]+=", words[0]):
            words = words[1:]
        if words[:2] == ["cargo", "xtask"]:
            return self.unknown("xtask", words[2:])
        if words[:1] == ["slipsense"]:
            return self.unknown("slipsense", words[1:])
        if words[:1] == ["cargo"] and len(words) > 1:
            return self.cargo(words[1:])
        return None

    def unknown(self, program, words):
        path = []
        names, options = self.help(program)
        while words and names:
            if words[0] in names:
                path, words = [*path, words[0]], words[1:]
                names, options = self.help(program, *path)
            elif SUBCOMMAND.match(words[0]):
                return f"{program} {' '.join(path)} has no command `{words[0]}`"
            else:
                break
        # What the twin is given is in its own help, which lies in another build.
        if options is None or path == ["twin"]:
            return None
        for word in words:
            option = word.partition("=")[0]
            if option.startswith("--") and len(option) > 2 and option not in options:
                return f"{program} {' '.join(path)} has no option `{option}`"
        if program == "xtask" and path == ["test"]:
            named = [step for option, step in zip(words, words[1:]) if option == "--only"]
            missing = [step for step in named if SUBCOMMAND.match(step) and step not in self.steps]
            return f"there is no step {', '.join(missing)}" if missing else None
        return None

    def cargo(self, words):
        ours, _, rest = " ".join(words).partition(" -- ")
        ours = ours.split()
        if "-" in ours[0] and ours[0] not in self.aliases:
            return f"there is no alias {ours[0]}"
        pairs = list(zip(ours, ours[1:]))
        packages = [name for option, name in pairs if option in ("-p", "--package")]
        for name in packages:
            if SUBCOMMAND.match(name) and name not in self.targets:
                return f"the workspace has no package {name}"
        for option, name in pairs:
            known = set().union(*(self.targets.get(package, set()) for package in packages or self.targets))
            if option in ("--test", "--example", "--bin") and SUBCOMMAND.match(name) and name not in known:
                return f"no {option[2:]} is called {name}"
        if ours[0] == "run" and rest and not packages:
            return self.unknown("slipsense", rest.split())
        return None


def commands(text):
    """The command lines of a document: in blocks of shell and in code spans."""
    for language, block in FENCE.findall(text):
        if language in ("sh", "bash", "console"):
            yield from block.replace("\\\n", " ").splitlines()
    yield from SPAN.findall(FENCE.sub("", text))


def check_commands(text, programs, faults):
    count = 0
    for line in commands(text):
        for part in re.split(r"&&|\||;|\$\(", line.lstrip("$ ")):
            try:
                words = shlex.split(part, comments=True)
            except ValueError:
                continue
            fault = programs.fault(words)
            count += words[:1] in (["slipsense"], ["cargo"])
            if fault:
                faults.append(f"`{line.strip()}`: {fault}")
    return count


def check_figures(text, faults):
    rows = [line for line in text.splitlines() if line.startswith("|")]
    head = [at for at, line in enumerate(rows) if re.match(r"\|[\s|:-]+$", line)]
    for at, row in enumerate(rows):
        last = row.rstrip("|").rsplit("|", 1)[-1]
        if at not in head and at + 1 not in head and not re.search(r"`[^`]+ [^`]+`|the same", last):
            faults.append(f"this row names no command: {row}")


def check_names(text, faults):
    """Code spans that are paths or Rust names."""
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.rs"))
    for span in SPAN.findall(FENCE.sub("", text)):
        if "/" in span:
            exists = (ROOT / span).exists() or (ROOT / "src" / span).exists()
        elif re.fullmatch(r"\w+((::|\.)\w+)*(\(\))?", span):
            names = re.findall(r"\w+", span)
            exists = all(re.search(rf"\b{name}\b", source) for name in names)
        else:
            continue
        if not exists:
            faults.append(f"`{span}` does not exist in the source")


def main():
    programs = Programs(*sys.argv[1:])
    pages = [README, ROOT / "CONTRIBUTING.md", ROOT / "model/MODEL_CARD.md", *sorted(BOOK.rglob("*.md"))]
    bad, count = 0, 0
    for path in pages:
        text, faults = path.read_text(encoding="utf-8"), []
        check_links(path, FENCE.sub("", text), faults)
        count += check_commands(text, programs, faults)
        if path == README:
            lines, words = len(text.splitlines()), len(text.split())
            if lines > README_LINES or words > README_WORDS:
                faults.append(f"{lines} lines and {words} words, {README_LINES} and {README_WORDS} are allowed")
        if path.name == "figures.md":
            check_figures(text, faults)
        if path.name == "life-of-a-taxel.md":
            check_names(text, faults)
        for fault in faults:
            print(f"{path.relative_to(ROOT)}: {fault}")
        bad += len(faults)
    print(f"{len(pages)} documents, {count} commands: {bad} faults")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
