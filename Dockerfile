# The image of every node: Ray of the pinned version (constraints.txt), with this project on top.
FROM rayproject/ray:2.60.0-py311-cpu

# A new volume takes its owner from the folder that it covers; Ray runs as user `ray`, who could not write to root's.
USER root
RUN install -d -o ray -g users /results /dashboards
USER ray

COPY --chown=ray:users pyproject.toml constraints.txt README.md LICENSE /tmp/apel/
COPY --chown=ray:users apel /tmp/apel/apel
COPY --chown=ray:users cluster /tmp/apel/cluster
COPY --chown=ray:users jobs /tmp/apel/jobs
# What the image has beside the service: deep, sb3, tensorboard, mlflow, wandb, or several with commas between.
ARG EXTRAS=
# The sources go again: of two copies, Python and the cache of compiled code would now and then take the wrong one.
RUN cd /tmp/apel && pip install --no-cache-dir -c constraints.txt ".[service${EXTRAS:+,$EXTRAS}]" && rm -rf /tmp/apel

# Compile now, once: otherwise every process of a new container would compile the same at the same time. It is done
# again by itself where the CPU is of another kind than the builder's.
RUN python -c "from apel.building.registry import SELECTORS; from cluster.compiling import compile_for; compile_for(SELECTORS)"

WORKDIR /home/ray
