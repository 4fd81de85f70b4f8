python := `command -v python3.11 || command -v python3.10 || command -v python3`
bin := ".venv/bin"

# "$@" passes arguments to a command unchanged, quoted or not
set positional-arguments
pip := bin / "pip install --quiet"
torch := "torch==2.13.0" # not in the lock files, since its builds have different hashes; one that is there already is kept
uv := "uv==0.13.9"
# the lock files are for Python 3.11; other versions install what pyproject.toml allows
is_locked := if python =~ "python3.11$" { "true" } else { "false" }
locked := "--no-deps --require-hashes -r"
packages := if is_locked == "true" { locked + " requirements.lock" } else { torch + " -e '.[dev]'" }
docs_packages := if is_locked == "true" { locked + " requirements-docs.lock" } else { "-e '.[docs]'" }

demo := "+table=collision split=all hydra.sweep.dir=outputs/demo"

# list the recipes
default:
    @just --list

# create .venv with what running and testing need (again only when the lock file changes)
setup:
    @cmp -s requirements.lock .venv/requirements.lock || {{just_executable()}} install

[private]
install:
    @echo "installing $(grep -c == requirements.lock) packages in .venv: 2.4 GB with torch, a few minutes"
    @{{python}} -m venv .venv
    @{{pip}} {{packages}}
    @echo "installing torch and this checkout"
    @{{pip}} {{torch}}
    @{{pip}} --no-deps --no-build-isolation -e .
    @cp requirements.lock .venv/

# write the hashes of the lock files, after a version in one was changed
lock: setup
    {{pip}} {{uv}}
    for lock in requirements*.lock; do {{bin}}/uv pip compile --quiet --upgrade --no-deps --generate-hashes --no-annotate --custom-compile-command "just lock" $lock -o $lock; done

# write sbom.json, a CycloneDX list of the installed packages
sbom: setup
    {{pip}} {{uv}}
    {{bin}}/uvx --from cyclonedx-bom==7.5.0 cyclonedx-py environment .venv --output-file sbom.json

# draw collisions, train four models on them and test six, and report tables and figures (minutes on two cores)
demo: setup
    {{bin}}/python src/look.py scenario=collision directory=outputs/demo/pictures
    {{bin}}/python src/train.py {{demo}} +row=copy_c,copy_b
    {{bin}}/python src/train.py {{demo}} +row=cophynet,in,npe,in_sup trainer.max_epochs=15 hydra/launcher=local
    {{bin}}/python src/report.py outputs=outputs/demo
    @echo "Images: outputs/demo/pictures. Curves: {{bin}}/tensorboard --logdir outputs/demo"

# run the tests (minutes), or some of them: just test tests/models
test *args: setup
    {{bin}}/pytest -n 2 --dist worksteal "$@"

# run the slow tests too; those with a browser need Debian's chromium
test-slow *args: setup
    @cmp -s requirements-slow.lock .venv/requirements-slow.lock || ({{pip}} {{locked}} requirements-slow.lock && cp requirements-slow.lock .venv/)
    {{bin}}/pytest -m 'not cluster and not pythons' "$@"

# run the tests on a SLURM cluster of one node; needs Debian's slurmctld slurmd slurm-client
test-cluster *args: setup
    {{bin}}/pytest -m cluster -rs "$@" tests/cluster

# install the wheel in an environment of every Python that is found, train, score and report there: just test-pythons -k 3.13
test-pythons *args: setup
    {{bin}}/pytest -m pythons -rs --durations=0 "$@" tests/pythons

# check format, lint and types
check: setup
    {{bin}}/ruff format --check && {{bin}}/ruff check && {{bin}}/mypy

# write the tables of the docs from results.csv and build docs/_build/html; a broken link or a failing cell of the tutorial is an error
docs: setup
    @cmp -s requirements-docs.lock .venv/requirements-docs.lock || ({{pip}} {{docs_packages}} && cp requirements-docs.lock .venv/)
    {{bin}}/python docs/generate.py
    {{bin}}/python -m sphinx --quiet --fail-on-warning --keep-going --jobs auto -d docs/_build/doctrees docs docs/_build/html
    @echo "docs/_build/html/index.html"

# measure speed as ratios within one run: just bench training
bench *args: setup
    {{bin}}/python benchmarks/bench.py "$@"
