# deepmf-sumo without a GPU: docker build -t deepmf-sumo .
# In a folder with your SUMO files: docker run --rm --user "$(id -u)" -v "$PWD:/work" deepmf-sumo attack my.sumocfg
FROM python:3.11-slim AS build
# uv knows where PyTorch's builds are: cpu, or cu128 and others; empty for the one that pip would take.
ARG TORCH_BACKEND=cpu
# Who runs the image may not write beside the modules: without bytecode each start would compile them all again.
# By hash, unchecked: layers round times of files, and a module with another time than its bytecode remembers is compiled.
ENV PYC_INVALIDATION_MODE=UNCHECKED_HASH
ENV INSTALL="uv pip install --no-cache --compile-bytecode --python /opt/deepmf-sumo -c /src/constraints.txt"
RUN pip install --no-cache-dir uv && python -m venv --without-pip /opt/deepmf-sumo
COPY constraints.txt /src/
RUN $INSTALL ${TORCH_BACKEND:+--torch-backend $TORCH_BACKEND} torch
COPY pyproject.toml README.md LICENSE /src/
COPY deepmf_sumo /src/deepmf_sumo
COPY sumo_nets /src/sumo_nets
COPY scenarios /src/scenarios
COPY suite /src/suite
COPY studies/paper.yaml /src/studies/paper.yaml
RUN $INSTALL ${TORCH_BACKEND:+--torch-backend $TORCH_BACKEND} /src

FROM python:3.11-slim
# Libraries that SUMO's wheels expect from the system, also without a window.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libatomic1 libexpat1 libgl1 libx11-6 libxext6 libxrender1 zlib1g \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/deepmf-sumo /opt/deepmf-sumo
# The cache lies where any user may write: --user gives the files in /work the owner that you want.
ENV PATH=/opt/deepmf-sumo/bin:$PATH DEEPMF_SUMO_HOME=/tmp/deepmf-sumo MPLCONFIGDIR=/tmp/matplotlib
RUN useradd --create-home deepmf && mkdir /work && chown deepmf /work
USER deepmf
WORKDIR /work
ENTRYPOINT ["deepmf-sumo"]
CMD ["--help"]
