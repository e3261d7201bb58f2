PYTHON ?= python3
# What runs here does not reach the robots on the network.
ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Threads cost more than they bring to matrices as small as these.
OPENBLAS_NUM_THREADS ?= 1
export PYTHON ROS_AUTOMATIC_DISCOVERY_RANGE OPENBLAS_NUM_THREADS

.PHONY: help demo dashboard example lint test colcon consistency browser latency page mutants fuzz soak bench clean

help:  ## print this
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-11s %s\n", $$1, $$2 }' Makefile

demo:  ## drive a simulated robot: make demo ARGS='--path circle'
	@.ci/environment run demo $(ARGS)

dashboard:  ## see and drive a simulated robot in the browser: make dashboard ARGS='--port 8081'
	@.ci/environment run dashboard --simulate $(ARGS)

lint:  ## ruff, oxlint, mypy, ament_flake8, ament_pep257
	@.ci/environment test .ci/lint

# rclpy then refuses a field of the wrong type, which it otherwise corrupts silently.
test colcon: export ROS_PYTHON_CHECK_FIELDS = 1

test: lint  ## lint, then pytest: make test ARGS='-k odometry'
	@.ci/environment test .ci/tf2_msgs
	@printf '\n== pytest\n'
	@.ci/environment test python -m pytest -n 3 --dist loadfile $(ARGS)

colcon:  ## build and test as a ROS workspace does
	@.ci/environment test .ci/tf2_msgs
	@.ci/environment test .ci/colcon

# The scripts in test/ import each other and the helpers from there.
consistency latency page mutants fuzz soak bench: export PYTHONPATH := test$(if $(PYTHONPATH),:$(PYTHONPATH))

consistency:  ## check the covariance, and the error bars of calibrations, in simulation
	@.ci/environment test python -m checks.consistency $(ARGS)
	@[ -n '$(ARGS)' ] || .ci/environment test python -m checks.consistency --calibrations 500

example:  ## calibrate a simulated robot by its logs: doc/calibration.md is that run
	@.ci/environment run python -m diffdrive_ros.tools.example $(ARGS)

browser:  ## test the dashboard in a real browser, Debian's chromium: minutes
	@.ci/environment test python -m pytest -m browser test/dashboard $(ARGS)

latency:  ## measure from key press to wheel command: make latency ARGS='--presses 50'
	@.ci/environment test python -m checks.page_latency $(ARGS)

page:  ## measure what the page costs an odometry beside it: make page ARGS='--rounds 3'
	@.ci/environment test python -m checks.page_cost $(ARGS)

mutants:  ## check that tests detect the loss of each behaviour: make mutants ARGS='7 23', ARGS='--tenth 3'
	@.ci/environment test python -m checks.mutants $(ARGS)

fuzz:  ## send ten million messages through the core: make fuzz ARGS='--seed 2'
	@.ci/environment test python -m checks.fuzz $(ARGS)

soak:  ## drive for 15 minutes with a fault each second: make soak ARGS='--minutes 60'
	@.ci/environment test python -m checks.soak $(ARGS)

bench:  ## measure what node and core cost, into doc/performance.md: make bench ARGS=--quick prints
	@.ci/environment test python -m benchmark.benchmark $(ARGS)

clean:  ## remove all that was made, the virtual environments too
	rm -rf .venv .venv-ros .colcon build dist install log demo.png example optiodom *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find diffdrive_ros test -name __pycache__ -prune -exec rm -rf {} +
