"""The command in a process that may open few files: `trueup …` with a limit of TRUEUP_TEST_FILES
descriptors."""

import os
import resource

limit = int(os.environ.pop("TRUEUP_TEST_FILES"))
resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

if __name__ == "__main__":
    from trueup_cli.main import main

    main()
