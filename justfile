python := `command -v python3.11 || command -v python3.10 || command -v python3`
bin := ".venv/bin"

# "$@" hands words to a command as they are, in quotes or not
set positional-arguments
# the lock is for Python 3.11; others take what pyproject.toml allows, with the same torch
packages := if python =~ "python3.11$" { "-r requirements.lock" } else { "torch==2.13.0 -e '.[dev,docs]'" }

demo := "+table=collision split=all hydra.sweep.dir=outputs/demo"

# list the recipes
default:
    @just --list

# make .venv with the locked packages (again only when the lock changes)
setup:
    @cmp -s requirements.lock .venv/requirements.lock || ({{python}} -m venv .venv && {{bin}}/pip install {{packages}} && {{bin}}/pip install --no-deps -e . && cp requirements.lock .venv/)

# pictures of collisions, five models on them, and the table and figures of their results (minutes on two cores)
demo: setup
    {{bin}}/python src/look.py scenario=collision directory=outputs/demo/pictures
    {{bin}}/python src/train.py {{demo}} +row=copy_c,copy_b
    {{bin}}/python src/train.py {{demo}} +row=cophynet,in,npe,in_sup trainer.max_epochs=15 hydra/launcher=local
    {{bin}}/python src/report.py outputs=outputs/demo
    @echo "Pictures: outputs/demo/pictures. Curves: {{bin}}/tensorboard --logdir outputs/demo"

# run the tests (minutes), or some: just test tests/models
test *args: setup
    {{bin}}/pytest -n 2 "$@"

# run the long tests too; those with a browser need Debian's chromium
test-slow *args: setup
    {{bin}}/pytest -m 'not cluster' "$@"

# run the tests on a SLURM of one node; Debian: slurmctld slurmd slurm-client
test-cluster *args: setup
    {{bin}}/pytest -m cluster -rs "$@" tests/cluster

# format, lint and type checks
check: setup
    {{bin}}/ruff format --check && {{bin}}/ruff check && {{bin}}/mypy

# build the documentation as a site, docs/_build/html; a link that leads nowhere or a failing cell of the tutorial is an error
docs: setup
    {{bin}}/python -m sphinx --quiet --fail-on-warning --keep-going --jobs auto -d docs/_build/doctrees docs docs/_build/html
    @echo "docs/_build/html/index.html"

# measure speed: ratios within one run
bench *args: setup
    {{bin}}/python benchmarks/bench.py "$@"

# train and test one model on one split, or sweep with -m: just train scenario=balls model=cophynet
train *args: setup
    {{bin}}/python src/train.py "$@"

# generate the datasets of a split: just generate scenario=balls size=small
generate *args: setup
    {{bin}}/python src/generate.py "$@"

# prove a dataset sound: just audit scenario=balls size=small
audit *args: setup
    {{bin}}/python src/audit.py "$@"

# tables from outputs/, ours beside the paper's numbers
report *args: setup
    {{bin}}/python src/report.py "$@"

# generated data in the format of the released dataset: just export scenario=balls root=/where/CoPhy_224
export *args: setup
    {{bin}}/python src/export.py "$@"

# positions and presence in all frames, by a trained de-renderer: just derender scenario=balls
derender *args: setup
    {{bin}}/python src/derender.py "$@"

# pictures of a dataset for people: just look scenario=balls
look *args: setup
    {{bin}}/python src/look.py "$@"

# what predict.py needs, in outputs/trained: CoPhyNet, and a de-renderer of 400 experiments: just trained balls 4
trained scenario="collision" objects="2": setup
    {{bin}}/python src/train.py scenario={{scenario}} model=cophynet hydra.run.dir=outputs/trained/{{scenario}}/cophynet
    {{bin}}/python src/train.py scenario={{scenario}} model=derenderer size.num_experiments.{{scenario}}.{{objects}}=400 \
        hydra.run.dir=outputs/trained/{{scenario}}/derenderer

# the human study of Table 1, on localhost: just study scenario=blocktower
study *args: setup
    {{bin}}/python src/study.py "$@"

# from pictures of AB and C to a clip of D: just predict --help
predict *args: setup
    {{bin}}/python src/predict.py "$@"
