# Everything in one image: docker build -t sal_height . && docker run --rm sal_height run --preset small --out /tmp/out
FROM python:3.12-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends gcc g++ make && rm -rf /var/lib/apt/lists/*
WORKDIR /sal_height
COPY . .
RUN make setup
ENV PATH=/sal_height/.venv/bin:$PATH
ENTRYPOINT ["sal-height"]
CMD ["--help"]
