"""The `trueup` command in a process that may open at most TRUEUP_TEST_FILES descriptors."""

import os
import resource

limit = int(os.environ.pop("TRUEUP_TEST_FILES"))
resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

if __name__ == "__main__":
    from trueup_cli.main import main

    main()
