// Writes vectors of tree hashes, proofs and signed notes, as the Go module golang.org/x/mod makes them.
package main

import (
	"bytes"
	"encoding/base64"
	"encoding/json"
	"fmt"
	"os"

	"golang.org/x/mod/sumdb/note"
	"golang.org/x/mod/sumdb/tlog"
)

type store []tlog.Hash

func (s store) ReadHashes(at []int64) ([]tlog.Hash, error) {
	out := make([]tlog.Hash, len(at))
	for i, n := range at {
		out[i] = s[n]
	}
	return out, nil
}

func check(err error) {
	if err != nil {
		panic(err)
	}
}

type seeded struct{}

func (seeded) Read(p []byte) (int, error) {
	for i := range p {
		p[i] = byte(i)
	}
	return len(p), nil
}

func main() {
	if len(os.Args) == 3 { // KEY FILE: verify a checkpoint
		verifier, err := note.NewVerifier(os.Args[1])
		check(err)
		data, err := os.ReadFile(os.Args[2])
		check(err)
		opened, err := note.Open(data, note.VerifierList(verifier))
		check(err)
		tree, err := tlog.ParseTree(append([]byte("go.sum database tree\n"), opened.Text[bytes.IndexByte([]byte(opened.Text), '\n')+1:]...))
		check(err)
		fmt.Println("accepted", opened.Sigs[0].Name, tree.N, tree.Hash)
		return
	}
	var hashes store
	out := map[string]any{}
	var roots, inclusions, consistencies []any
	for n := int64(0); n < 17; n++ {
		more, err := tlog.StoredHashes(n, []byte(fmt.Sprintf("entry %d", n)), hashes)
		check(err)
		hashes = append(hashes, more...)
		root, err := tlog.TreeHash(n+1, hashes)
		check(err)
		roots = append(roots, root.String())
		for m := int64(0); m <= n; m++ {
			record, err := tlog.ProveRecord(n+1, m, hashes)
			check(err)
			inclusions = append(inclusions, []any{m, n + 1, record})
			tree, err := tlog.ProveTree(n+1, m+1, hashes)
			check(err)
			consistencies = append(consistencies, []any{m + 1, n + 1, tree})
		}
	}
	skey, vkey, err := note.GenerateKey(seeded{}, "log.example/robots")
	check(err)
	signer, err := note.NewSigner(skey)
	check(err)
	root, err := base64.StdEncoding.DecodeString(roots[16].(string))
	check(err)
	text := "log.example/robots\n17\n" + base64.StdEncoding.EncodeToString(root) + "\n"
	signed, err := note.Sign(&note.Note{Text: text}, signer)
	check(err)
	out["roots"], out["inclusion"], out["consistency"] = roots, inclusions, consistencies
	out["signer"], out["verifier"], out["checkpoint"] = skey, vkey, string(signed)
	encoded, err := json.Marshal(out)
	check(err)
	os.Stdout.Write(encoded)
}
