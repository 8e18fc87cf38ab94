# Both commands do all the set-up they need: see README.md.

.PHONY: run test wheel gpu validate measure

run: ## simulate the dam break and draw its pictures
	@bash .ci/demo

test: ## all tests on lavapipe, those of the kernels and the solver once more on SwiftShader, and those of the Python package
	@bash .ci/test

wheel: ## the wheel of the Python package, into target/wheels
	@bash .ci/wheel

gpu: ## measure the GPU of this machine in ten minutes, into docs/measured/gpu; builds target/gpu, whose `run` does the same elsewhere; ARGS=--build-only
	@bash .ci/gpu $(ARGS)

validate: ## compare with theory, experiments and other programs, at most an hour; ARGS=--quick: 5 minutes, ARGS=--full: all; CASES="S2 S9" runs a part
	@bash .ci/validate $(ARGS) $(CASES)

measure: ## the benches behind docs/measured, in at most 60 minutes; ARGS=--quick in 5, ARGS=--full the long ones too, ARGS=--resume resumes
	@bash .ci/measure $(ARGS)
