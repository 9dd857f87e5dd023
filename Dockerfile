# A CPU, videos by software rendering:
#   docker build -t carpark_mj .
#   docker run --rm -v "$PWD/runs:/work/runs" carpark_mj evaluate square
FROM python:3.11-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/carpark_mj
COPY . .
RUN pip install --no-cache-dir -e ".[train,eval]" \
    && pip install --no-cache-dir ./formats
WORKDIR /work
ENTRYPOINT ["carpark_mj"]
