"""DDS below the nodes: domains, ports, quality of service, executors, what ended processes left, who is connected."""
