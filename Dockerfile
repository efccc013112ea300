# docker build -t ves-gym . && docker run --rm ves-gym plan --goal 60,40,-30
FROM python:3.13-slim
WORKDIR /src
# the versions, by their hashes, that the tests have passed with; a layer of their own, for
# they change less often than the sources
COPY constraints-run.txt .
RUN pip install --no-cache-dir --require-hashes -r constraints-run.txt
COPY pyproject.toml README.md LICENSE ./
COPY ves_gym ves_gym
RUN pip install --no-cache-dir --no-deps --no-build-isolation . \
    && useradd --create-home ves
USER ves
WORKDIR /home/ves
ENTRYPOINT ["ves-gym"]
CMD ["--help"]
