# docker build -t deepmf-sumo . && docker run --rm -v "$PWD:/work" deepmf-sumo attack my.sumocfg
FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY deepmf_sumo deepmf_sumo
COPY sumo_nets sumo_nets
COPY scenarios scenarios
COPY studies studies
# An index of CPU builds of torch saves several GB: --build-arg TORCH_INDEX=URL
ARG TORCH_INDEX=
RUN python -m venv /opt/deepmf-sumo \
 && if [ -n "$TORCH_INDEX" ]; then /opt/deepmf-sumo/bin/pip install --no-cache-dir --index-url "$TORCH_INDEX" torch; fi \
 && /opt/deepmf-sumo/bin/pip install --no-cache-dir -c constraints.txt .

FROM python:3.12-slim
# SUMO's programs need these of a desktop's libraries, also without a window.
RUN apt-get update \
 && apt-get install -y --no-install-recommends libgl1 libglu1-mesa libxext6 libxrender1 libxft2 libfontconfig1 libxcursor1 libxrandr2 libxi6 libxfixes3 \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --create-home user
COPY --from=build /opt/deepmf-sumo /opt/deepmf-sumo
ENV PATH=/opt/deepmf-sumo/bin:$PATH
USER user
WORKDIR /work
ENTRYPOINT ["deepmf-sumo"]
CMD ["--help"]
