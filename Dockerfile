# The environment of the README: docker build -t vibration-bench . && docker run --rm vibration-bench
FROM python:3.11-slim
WORKDIR /vibration-bench
COPY constraints.txt pyproject.toml README.md LICENSE ./
COPY bench bench
COPY methods methods
COPY conf conf
# The CPU build of torch: the default one adds CUDA libraries.
RUN pip install --no-cache-dir -c constraints.txt --extra-index-url https://download.pytorch.org/whl/cpu -e ".[all]"
COPY results results
ENTRYPOINT ["python", "-m", "bench"]
CMD ["data=bench/data/measured/airtrack/glider.csv", "columns=t:0,x:1"]
